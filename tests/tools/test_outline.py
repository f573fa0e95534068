"""The study of outlines: two outlines of the same presses, side by side."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from support.half_family import half_family
from tools.studies import outline


@pytest.mark.slow
def test_both_outlines_are_judged_on_the_same_presses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--objects", "ball", "--profile", "fast", "--references", "1", "--presses", "8"]
    with half_family():
        outline.main(["--sensors", "half:default", *words, "--out", str(tmp_path)])
    assert capsys.readouterr().out == (tmp_path / "outline.md").read_text(encoding="utf-8")
    with (tmp_path / "outline.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    by_network, by_heights = (
        [row for row in rows if row["outline"] == name] for name in ("network", "kmeans")
    )
    assert len(by_network) == len(by_heights) == 9
    for one, other in zip(by_network, by_heights, strict=True):
        same = ("image", "depth_mm", "x_mm", "true_depth_mm")
        assert [one[key] for key in same] == [other[key] for key in same]
    assert [row["iou"] for row in by_network] != [row["iou"] for row in by_heights]
