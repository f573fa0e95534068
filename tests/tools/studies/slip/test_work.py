from __future__ import annotations

import csv
import importlib
import math
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tools.studies.slip.work import HeldRow, Plan, ReleaseRow, Row, SlideRow, study


@pytest.mark.slow
def test_a_slide_and_a_hold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One run for the rows and for the tables that the program writes of them."""
    slip: Any = importlib.import_module("tools.studies.slip.__main__")
    rows: list[Row] = []

    def kept(*words: Any) -> tuple[Row, ...]:
        rows.extend(study(*words))
        return tuple(rows)

    monkeypatch.setattr(slip, "Plan", partial(Plan, objects=("ball",), speeds_mm_s=(20.0,), held_s=0.5, released_s=3.0))
    monkeypatch.setattr(slip, "study", kept)
    slip.main(["--sensors", "5", "--profile", "fast", "--out", str(tmp_path)])
    (held,) = [row for row in rows if isinstance(row, HeldRow)]
    assert (held.held_s, held.slips) == (0.5, 0)
    (released,) = [row for row in rows if isinstance(row, ReleaseRow)]
    assert 0 <= released.dent_mm < 0.1 * released.depth_mm + 0.01
    assert released.frames + released.phantoms > 0
    slides = [row for row in rows if isinstance(row, SlideRow)]
    assert len(slides) == 2
    for row in slides:
        assert 0.3 < row.onset_s < 1.0
        assert not math.isnan(row.told_s)
        assert 0 < row.true_mm_s <= 21
    assert capsys.readouterr().out == (tmp_path / "slip.md").read_text(encoding="utf-8")
    for kind, count in (("slides", 2), ("held", 1), ("releases", 1)):
        with (tmp_path / f"slip_{kind}.csv").open(encoding="utf-8") as file:
            assert len(list(csv.DictReader(file))) == count
