"""What is named as ageing in a history of looks, and when its limit is expected."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from tacshade_edge.calibration.ageing.appearance import Appearance
from tacshade_edge.calibration.ageing.wears import (
    COLUMNS,
    DAYS_MAX,
    LIMITS,
    NAMED,
    RECENT,
    History,
    Wear,
    date_of,
    judge,
    named_each_day,
    words,
)

FIRST = 20_000
SOUND = Appearance(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
Look = Callable[[int], dict[str, float]]


def history(look: Look, days: int = 100, every: int = 1) -> History:
    """Looks with a day-to-day noise."""
    rng = np.random.default_rng(3)
    noise = (0.02, 0.02, 0.005, 0.005, 0.02, 0.002)
    numbers = np.arange(0, days, every)
    looks = rng.normal(0, noise, (len(numbers), len(COLUMNS)))
    for row, day in zip(looks, numbers, strict=True):
        for name, value in look(int(day)).items():
            row[COLUMNS.index(name)] += value
    return History((FIRST + numbers).astype(np.int32), looks.astype(np.float32))


def named(found: History) -> dict[str, Wear]:
    return {wear.kind: wear for wear in judge(found) if wear.named}


def test_a_sound_sensor_and_a_short_history_name_nothing() -> None:
    assert judge(History.empty()) == ()
    assert judge(history(lambda day: {}, RECENT - 1)) == ()
    assert len(judge(history(lambda day: {}, RECENT))) == len(LIMITS)
    assert named(history(lambda day: {}, 365)) == {}


@pytest.mark.parametrize(
    ("kind", "look"),
    [
        ("light", lambda day: {"white": -0.003 * day, "dark": -0.003 * day}),
        ("light", lambda day: {"white": -0.001 * day, "dark": -0.001 * day, "slope_row": 0.2}),
        ("markers", lambda day: {"white": -0.003 * day, "dark": -0.0005 * day}),
        ("markers", lambda day: {"white": -0.003 * day, "dark": 0.001 * day}),
        ("markers", lambda day: {"white": -0.003 * day, "dark": -0.0019 * day}),
        ("pins", lambda day: {"bent_part": 0.02}),
        ("gel", lambda day: {"sunk_mm": 0.002 * day}),
        ("gel", lambda day: {"sunk_mm": -0.002 * day}),
    ],
)
def test_each_wear_is_named_by_its_kind(kind: str, look: Look) -> None:
    assert list(named(history(look))) == [kind]


def test_the_limit_is_forecast_from_the_latest_growth() -> None:
    grows = history(lambda day: {"bent_part": 0.0004 * max(day - 40, 0)}, 95)
    wear = named(grows)["pins"]
    # 0.03 is reached 75 days after the growth began.
    assert wear.limit_day == pytest.approx(FIRST + 115, abs=10)
    assert wear.per_year == pytest.approx(0.0004 * 365, rel=0.2)
    assert words(wear).endswith(f"errors are expected to stay as stated until {date_of_(wear)}")


def date_of_(wear: Wear) -> str:
    assert wear.limit_day is not None
    return date_of(wear.limit_day)


def test_what_came_at_once_does_not_grow() -> None:
    wear = named(history(lambda day: {"bent_part": 0.02}))["pins"]
    assert (wear.per_year, wear.limit_day, wear.beyond) == (None, None, False)
    assert words(wear).endswith("it does not grow")


def test_beyond_its_limit_nothing_is_forecast() -> None:
    wear = named(history(lambda day: {"sunk_mm": 0.5}))["gel"]
    assert wear.beyond
    assert words(wear).endswith("expect larger errors than the calibration stated")


def test_a_week_of_dirt_or_load_is_no_wear() -> None:
    spell = history(lambda day: {"bent_part": 0.2 if 90 <= day < 96 else 0.0})
    assert named(spell) == {}


def test_what_rests_on_the_skin_for_half_of_the_looks_is_no_gel() -> None:
    spells = history(lambda day: {"sunk_mm": 0.3 if day % 14 < 8 else 0.0}, 100)
    assert named(spells) == {}


def alarms(kind: str, look: Look, days: int = 365) -> int:
    """How often a kind is named anew in a year, as seen day by day."""
    found = history(look, days)
    judged = [
        kind in named(History(found.days[:k], found.looks[:k])) for k in range(RECENT, days + 1)
    ]
    return sum(now and not before for before, now in pairwise([False, *judged]))


def test_a_reading_that_goes_to_and_fro_across_its_amount_is_one_alarm() -> None:
    def swings(day: int) -> dict[str, float]:
        return {"sunk_mm": NAMED["gel"] + 0.03 * math.sin(2 * math.pi * day / 60)}

    assert alarms("gel", swings) == 1


def test_a_kind_that_was_named_goes_once_most_looks_are_well_below() -> None:
    def mended(day: int) -> dict[str, float]:
        return {"bent_part": 0.02 if 40 <= day < 100 or day >= 160 else 0.0}

    assert "pins" in named(history(mended, 105))
    assert named(history(mended, 125)) == {}
    assert alarms("pins", mended) == 2


def test_faded_markers_are_not_taken_for_gel() -> None:
    def faded(day: int) -> dict[str, float]:
        return {"white": -0.008 * day, "dark": -0.001 * day, "sunk_mm": -0.002 * day}

    # What they have lost is beyond its limit by day 70, before the tip seems to have swollen.
    assert list(named(history(faded))) == ["markers"]


def test_each_day_names_what_that_day_would_have_named() -> None:
    grows = history(lambda day: {"white": -0.004 * day, "dark": -0.004 * day}, 60)
    each = named_each_day(grows)
    for k in range(RECENT, 61):
        then = named(History(grows.days[:k], grows.looks[:k]))
        assert [kind for kind in each if each[kind][k - 1]] == list(then)
    assert not any(days[: RECENT - 1].any() for days in each.values())
    assert not any(len(days) for days in named_each_day(History.empty()).values())


def test_a_season_is_no_wear() -> None:
    def season(day: int) -> dict[str, float]:
        warmth = float(np.sin(2 * np.pi * day / 365))
        return {"white": -0.06 * warmth, "dark": -0.06 * warmth, "sunk_mm": 0.04 * warmth}

    found = history(season, 365)
    for k in range(RECENT, 365):
        assert named(History(found.days[:k], found.looks[:k])) == {}


def test_a_history_keeps_its_latest_days() -> None:
    long = History.empty()
    assert long.last_day is None
    for day in range(DAYS_MAX + 3):
        long = long.with_day(FIRST + day, SOUND)
    assert (len(long.days), int(long.days[0])) == (DAYS_MAX, FIRST + 3)
    assert long.looks.shape == (DAYS_MAX, len(COLUMNS))
    assert long.last_day == FIRST + DAYS_MAX + 2


def test_a_wear_is_named_well_before_its_limit() -> None:
    assert all(0 < NAMED[kind] < LIMITS[kind] for kind in LIMITS)
    assert date_of(0) == "1970-01-01"
