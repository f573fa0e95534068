"""The study of ageing: its years of sound and worn sensors."""

from __future__ import annotations

import numpy as np
import pytest

from support.calibrated_sensor import HALF, calibrated
from tacshade_edge.calibration.ageing.wears import History, judge
from tools.studies.ageing_years import SoundRow, YearRow, tables
from tools.testbed.simulator.days import FIRST_DAY, days_of, history_of, worn_look
from tools.testbed.simulator.wear import Wear


def test_days_are_the_same_again_and_none_is_of_a_weekend() -> None:
    days = list(days_of(3, 100))
    assert days == list(days_of(3, 100))
    assert 60 < len(days) < 72
    # 20 000 days after a Thursday is another Thursday.
    assert {(day.number - FIRST_DAY) % 7 for day in days} == {0, 1, 4, 5, 6}
    assert {day.dirty for day in days_of(3, 400)} == {day.loaded for day in days_of(4, 400)}


@pytest.mark.slow
def test_days_of_a_sound_sensor_name_nothing_and_worn_looks_do() -> None:
    days = list(days_of(1, 28))
    year = history_of(HALF, calibrated(HALF), 1, days)
    assert year.days.tolist() == [day.number for day in days]
    assert not [wear for wear in judge(year) if wear.named]
    added = np.array(
        [
            getattr(worn_look(HALF, calibrated(HALF), Wear(dimmed=0.3), 1), name)
            for name in ("white", "dark")
        ]
    )
    looks = year.looks.copy()
    looks[:, :2] += added
    assert [wear.kind for wear in judge(History(year.days, looks)) if wear.named] == ["light"]


def test_the_tables_count_what_was_named() -> None:
    rows: list[SoundRow | YearRow] = [
        SoundRow("pictures", 1, 120, 0, ""),
        SoundRow("drawn", 1, 240, 2, "pins"),
        SoundRow("drawn", 2, 240, 0, ""),
        YearRow("gel", 1, "gel", "gel", 200.0, 300.0, 310.0),
        YearRow("gel", 2, "gel+pins", "pins", 100.0, 150.0, 160.0),
    ]
    text = tables(rows)
    cells = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in text.splitlines()
        if line.startswith("|")
    ]
    assert ["gel", "0", "0", "0", "1", "0", "1", "1 of 2", "110", "10"] in cells
    assert ["drawn", "2", "2", "480", "2", "2", "0", "0", "1", "0"] in cells
