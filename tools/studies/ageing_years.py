"""A year of sensors, sound and worn: what is named, and when? A part of `ageing`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from tacshade_edge.calibration.ageing.wears import KINDS, History, Kind, judge, named_each_day
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.studies.evaluate.work import one_thread
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.types import F64, Calibration
from tools.testbed.simulator.days import (
    FIRST_DAY,
    YEAR,
    Day,
    calibrated_model,
    days_of,
    history_of,
    worn_look,
)
from tools.testbed.simulator.wear import Wear

DRAWN = 20  # further years for each of pictures
EVERY = 2  # of a year's looks are of pictures, for the time that they take
PARTS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of a year's wear of which pictures are taken
LASTING: dict[str, tuple[Kind | None, Callable[[float], Wear]]] = {
    "nothing": (None, lambda part: Wear()),
    "light, all": ("light", lambda part: Wear(dimmed=0.55 * part)),
    "light, one side": ("light", lambda part: Wear(dimmed_side=0.7 * part)),
    "markers": ("markers", lambda part: Wear(faded=0.7 * part)),
    "pins": ("pins", lambda part: Wear(bent_mm=1.0, bent_radius_mm=0.5 + 3.5 * part)),
    "gel": ("gel", lambda part: Wear(leaked_mm=0.4 * part)),
}
"""The kind that should be named, and the wear after a part of a year."""


@dataclass(frozen=True, slots=True)
class SoundRow:
    """A year of a sound sensor: its looks, and how often something was named anew."""

    how: str
    sensor: int
    looks: int
    alarms: int
    kinds: str


@dataclass(frozen=True, slots=True)
class YearRow:
    """A year of one sensor: what was named at its end, when something was named first, and what was
    forecast then; days are counted from the year's first.
    """

    wear: str
    sensor: int
    named: str
    first: str
    first_day: float
    forecast_day: float
    limit_day: float


def years_of(seed: int) -> list[SoundRow | YearRow]:
    """A year of a sound sensor by its pictures, further ones whose looks are drawn, and the first
    one with each wear.
    """
    with one_thread():
        model, calibration = calibrated_model(seed, 0)
        days = list(days_of(seed, YEAR))[::EVERY]
        year = history_of(model, calibration, seed, days)
        worn = [_worn(name, model, calibration, seed, year) for name in LASTING]
    # What each difference of a day does to a look, and what it leaves, which is drawn again.
    known = [day for day in days if day.number in year.days]
    does = np.linalg.lstsq(_design(known), year.looks, rcond=None)[0]
    left = year.looks - _design(known) @ does
    rng = np.random.default_rng((seed, 51))
    rows = [_sound("pictures", seed, year)]
    for k in range(DRAWN):
        others = list(days_of(seed + 100_000 * (k + 1), YEAR))
        looks = _design(others) @ does + left[rng.integers(0, len(left), len(others))]
        numbers = np.array([day.number for day in others], np.int32)
        rows.append(_sound("drawn", seed, History(numbers, looks.astype(np.float32))))
    return [*rows, *worn]


def _worn(
    name: str, model: SensorModel, calibration: Calibration, seed: int, sound: History
) -> YearRow:
    """A year of a wear that grows by the day: the looks of a sound year, and what the wear adds to
    a picture, between those of `PARTS`.
    """
    taken = [worn_look(model, calibration, LASTING[name][1](part), seed) for part in PARTS]
    added = np.array([astuple(look) for look in taken]) - astuple(taken[0])
    part = (sound.days - FIRST_DAY) / YEAR
    looks = sound.looks + np.stack([np.interp(part, PARTS, each) for each in added.T], axis=1)
    year = History(sound.days, looks.astype(np.float32))
    first, first_day, forecast_day, limit_day = "", math.nan, math.nan, math.nan
    named: list[Kind] = []
    for history in _days_of(year):
        wears = [each for each in judge(history) if each.named]
        named, day = [each.kind for each in wears], int(history.days[-1]) - FIRST_DAY
        if wears and not first:
            first, first_day = "+".join(named), day
            if wears[0].limit_day is not None:
                forecast_day = wears[0].limit_day - FIRST_DAY
        if math.isnan(limit_day) and any(each.beyond for each in wears):
            limit_day = day
    return YearRow(name, seed, "+".join(named), first, first_day, forecast_day, limit_day)


def _days_of(year: History) -> Iterator[History]:
    """A history after each of its days."""
    for k in range(1, len(year.days) + 1):
        yield History(year.days[:k], year.looks[:k])


def _design(days: Sequence[Day]) -> F64:
    """What differs on days, a row for each."""
    rows = [
        (1, math.log(day.light), day.swollen_mm, day.zoom - 1, day.dirty, day.loaded)
        for day in days
    ]
    return np.array(rows, np.float64)


def _sound(how: str, seed: int, year: History) -> SoundRow:
    """How often a year's days name something anew."""
    named = named_each_day(year)
    begins = np.array([np.diff(each, prepend=False) & each for each in named.values()])
    kinds = sorted(kind for kind, each in named.items() if each.any())
    alarms = int(begins.any(axis=0).sum())
    return SoundRow(how, seed, len(year.days), alarms, "+".join(kinds))


def sound_table(rows: Sequence[SoundRow]) -> str:
    """How often sound sensors were accused."""
    lines = []
    for how in ("pictures", "drawn"):
        some = [row for row in rows if row.how == how]
        lines.append(
            (
                how,
                str(len({row.sensor for row in some})),
                str(len(some)),
                str(sum(row.looks for row in some)),
                str(sum(row.alarms for row in some)),
                str(max(row.alarms for row in some)),
                *(str(sum(kind in row.kinds.split("+") for row in some)) for kind in KINDS),
            )
        )
    header = (
        "looks",
        "sensors",
        "years",
        "days",
        "false alarms",
        "most in a year",
        *(f"years with {kind}" for kind in KINDS),
    )
    return markdown(header, lines)


def year_table(rows: Sequence[YearRow]) -> str:
    """What was named at the year's end, by the true wear, and when."""
    lines = []
    for name, (kind, _) in LASTING.items():
        some = [row for row in rows if row.wear == name]
        named = [sum(row.named == each for row in some) for each in (*KINDS, "")]
        right = [row for row in some if row.first == kind]
        off = [
            abs(row.forecast_day - row.limit_day)
            for row in right
            if not math.isnan(row.forecast_day - row.limit_day)
        ]
        ahead = [row.limit_day - row.first_day for row in right if not math.isnan(row.limit_day)]
        lines.append(
            (
                name,
                *(str(count) for count in (*named, len(some) - sum(named))),
                f"{len(right)} of {len(some)}" if kind else "",
                f"{np.median(ahead):.0f}" if ahead else "",
                f"{np.median(off):.0f}" if off else "",
            )
        )
    header = (
        "true wear",
        *KINDS,
        "nothing",
        "several",
        "right at first",
        "days ahead",
        "forecast off, days",
    )
    return markdown(header, lines)


def tables(rows: Sequence[SoundRow | YearRow]) -> str:
    """Both tables."""
    worn = year_table([row for row in rows if isinstance(row, YearRow)])
    sound = sound_table([row for row in rows if isinstance(row, SoundRow)])
    return f"{worn.rstrip()}\n\n{sound.rstrip()}"
