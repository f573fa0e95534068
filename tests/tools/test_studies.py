"""What every study shares, by the study of drag: its table and its rows."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from support.half_family import half_family
from support.progress_lines import only_progress

from tools.studies import drag


@pytest.mark.slow
def test_a_study_writes_its_table_and_its_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drag, "DIRECTIONS", 1)
    words = ["--objects", "ball", "--profile", "fast", "--references", "1", "--presses", "8"]
    with half_family():
        drag.main(["--sensors", "half:default", *words, "--out", str(tmp_path)])
    reported = capsys.readouterr()
    assert only_progress(reported.err)
    assert reported.out == (tmp_path / "drag.md").read_text(encoding="utf-8")
    with (tmp_path / "drag.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 5 * 3
