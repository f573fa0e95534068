from __future__ import annotations

import math
from dataclasses import replace

from tools.studies.margin.summary import text
from tools.studies.margin.work import HeldRow, LoadRow

LOAD = LoadRow("some", "5", "ball", "pulled", 1.5, 1.0, 2.0, 1.9, 0.25)
HELD = HeldRow("some", "5", "ball", 1.5, 90.0, 2, 0.125, 0.5)


def cells(*rows: LoadRow | HeldRow) -> list[str]:
    return [cell.strip() for cell in text(rows).splitlines()[-1].strip("|").split("|")]


def test_a_slip_is_announced_100_ms_before_it() -> None:
    late, never = replace(LOAD, alarm_s=1.95), replace(LOAD, alarm_s=math.nan, stuck=math.nan)
    assert cells(LOAD, late, never, never, HELD) == ["some", "4", "25", "75", "0.25", "1.5", "2", "0.12"]


def test_what_never_slides_does_not_count() -> None:
    assert cells(LOAD, replace(LOAD, onset_s=math.nan, alarm_s=math.nan))[1:3] == ["1", "100"]
    assert cells(HELD)[1:5] == ["0", "", "", ""]
