"""The programs of the studies: what they write, and what they refuse."""

from __future__ import annotations

import csv
from functools import partial
from pathlib import Path
from types import ModuleType

import pytest
from support.half_family import half_family
from support.progress_lines import only_progress

from tools.studies import drag, limits, sigma

ONE_OBJECT = ["--objects", "ball", "--profile", "fast", "--references", "1", "--presses", "8"]
SMALL_PLAN = partial(
    limits.Plan,
    references=1, presses=8, null_frames=8, beyond_frames=5, ball_radii_mm=(6.0,), faint_depths_mm=(1.0,),
    faint_places=1, depths_mm=(3.0,), deep_places=1, pitches_mm=(1.9,), gaps_mm=(4.0,), widths_mm=(2.0,),
    fine_places=1, disturbed_places=1,
)  # fmt: skip
LIMITS = {"_nulls": 13, "_faint": 1, "_deep": 2, "_fine": 2, "_disturbed": 6}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("study", "words", "rows", "plots"),
    [
        (limits, ["--profile", "accurate"], LIMITS, 4),
        (drag, ONE_OBJECT, {"": 5 * 3}, 1),
        (sigma, ONE_OBJECT, {"": 2 * 3}, 1),
    ],
)
def test_one_writes_its_table_its_rows_and_its_plots(
    study: ModuleType,
    words: list[str],
    rows: dict[str, int],
    plots: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(drag, "DIRECTIONS", 1)
    monkeypatch.setattr(limits, "Plan", SMALL_PLAN)
    with half_family():
        study.main(["--sensors", "half:default", *words, "--out", str(tmp_path)])
    name = study.__name__.rpartition(".")[2]
    reported = capsys.readouterr()
    assert only_progress(reported.err)
    assert reported.out == (tmp_path / f"{name}.md").read_text(encoding="utf-8")
    for end, count in rows.items():
        with (tmp_path / f"{name}{end}.csv").open(encoding="utf-8") as file:
            assert len(list(csv.DictReader(file))) == count
    assert len([plot for plot in tmp_path.glob("*.png") if plot.stat().st_size > 10_000]) == plots
