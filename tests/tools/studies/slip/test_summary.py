from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tools.studies.slip.summary import is_early, is_in_time, text
from tools.studies.slip.work import HeldRow, ReleaseRow, SlideRow

ROW = SlideRow("fast", "5", "ball", 10.0, 20.0, 1.0, 1.05, 9.0, 10.0)


@pytest.mark.parametrize(
    ("onset_s", "told_s", "early", "in_time"),
    [
        (1.0, 1.05, False, True),
        (1.0, 1.11, False, False),
        (1.0, 0.96, False, True),
        (1.0, 0.9, True, False),
        (1.0, math.nan, False, False),
        (math.nan, 1.0, True, False),
        (math.nan, math.nan, False, False),
    ],
)
def test_when_a_slip_is_told(onset_s: float, told_s: float, early: bool, in_time: bool) -> None:
    row = replace(ROW, onset_s=onset_s, told_s=told_s)
    assert (bool(is_early(row)), bool(is_in_time(row))) == (early, in_time)


def test_the_tables() -> None:
    missed = replace(ROW, told_s=math.nan, found_mm_s=math.nan)
    printed = text(
        [ROW, missed, HeldRow("fast", "5", "ball", 60.0, 1), HeldRow("fast", "5", "cube", 60.0, 2)]
        + [ReleaseRow("fast", "5", "ball", 3.0, 0.2, told, 30, n) for told, n in ((0.05, 0), (0.15, 2), (math.nan, 0))]
    )
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in printed.splitlines() if line.startswith("|")]
    assert ["10 mm/s", "fast", "2", "50", "50", "1", "0", "0.90"] in lines
    assert ["fast", "2.0", "3"] in lines
    assert ["fast", "3", "0.20", "33", "150", "1", "90", "2"] in lines
