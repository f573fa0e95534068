"""What ages on a sensor, how far, and until when: judged from how it looked at rest on many days.

What has changed counts, not how fast: a season's warmth comes and goes, and never goes as far as
the amount from which on a wear is named. How fast it grows only says when the limit is reached.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields
from datetime import date
from typing import Final, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tacshade_edge.calibration.ageing.appearance import Appearance
from tacshade_edge.types import F32, F64, I32, Bool, frozen

DAYS_MAX: Final = 730
"""Days that a history keeps: the latest."""
DAY_MAX: Final = 2_900_000
"""A clock beyond the year 9900 is wrong, and the dates of forecasts would have no name."""
COLUMNS: Final = tuple(each.name for each in fields(Appearance))
Kind = Literal["light", "markers", "pins", "gel"]
KINDS: Final[tuple[Kind, ...]] = ("light", "markers", "pins", "gel")
LIMITS: Final[Mapping[Kind, float]] = {"light": 0.5, "markers": 0.4, "pins": 0.03, "gel": 0.2}
"""The amount of each wear up to which errors grow by about 0.1 mm or less (docs/results/ageing.md).
Light and white cost little until frames are refused soon after their limits.
"""
UNITS: Final[Mapping[Kind, str]] = {
    "light": "of the light",
    "markers": "of the white",
    "pins": "of the disc",
    "gel": "mm",
}
NAMED: Final[Mapping[Kind, float]] = {"light": 0.15, "markers": 0.15, "pins": 0.01, "gel": 0.12}
"""The amount of each from which on it is named: more than a season and the days of a sound sensor
bring."""
RECENT: Final = 14
"""Looks of which most must agree: some show a cold lamp, or an object that rests on the skin."""
# Wear shows in every look, dirt and what rests on the skin come and go: so what three in four looks
# exceed is its amount. It stays named until three in four look better than this part of the amount
# from which it was named: a season moves a reading by up to a third of that, to and fro.
_MOST, _STAYS = 0.75, 2 / 3
# If the dark has lost this part of what the white has, the light has gone: lamps take 0.85 or more
# of it, and faded markers at most 0.65, as the dark between them has some of their white.
_LIGHT_PART = 0.75
_TREND_DAYS = 60
# Deviations by which pairs of days must agree on a growth (Kendall 1938).
_SURE = 3.0
_YEARS_MAX = 10
_DAYS_PER_YEAR = 365
_FIRST_DAY = date(1970, 1, 1).toordinal()


@frozen
class History:
    """How a sensor looked at rest: `days` since 1970, int32 (N,), increasing, and the values of
    `Appearance` on each, float32 (N, `COLUMNS`).
    """

    days: I32
    looks: F32

    @classmethod
    def empty(cls) -> History:
        """A history of no day."""
        return cls(np.zeros(0, np.int32), np.zeros((0, len(COLUMNS)), np.float32))

    @property
    def last_day(self) -> int | None:
        """The latest day; None in an empty history."""
        return int(self.days[-1]) if len(self.days) else None

    def with_day(self, day: int, look: Appearance) -> History:
        """A history with one more day, which is later than all of it, without the oldest beyond
        `DAYS_MAX`.
        """
        row = np.array([astuple(look)], np.float32)
        days = np.append(self.days, np.int32(day))[-DAYS_MAX:]
        return History(days, np.concatenate((self.looks, row))[-DAYS_MAX:])


@dataclass(frozen=True, slots=True)
class Wear:
    """How far one kind of wear has come, in its `UNITS`, whether it is worth a word (`named`), and
    the day since 1970 on which it is expected to reach its limit; None if it does not grow, or not
    within ten years.
    """

    kind: Kind
    amount: float
    named: bool
    per_year: float | None
    limit_day: int | None

    @property
    def beyond(self) -> bool:
        """Whether errors are expected to be larger than stated."""
        return self.amount >= LIMITS[self.kind]


def judge(history: History) -> tuple[Wear, ...]:
    """Each kind of wear; none before a history has `RECENT` days."""
    if len(history.days) < RECENT:
        return ()
    is_light = _is_light(history.looks[-RECENT:])
    amounts, named = _amounts(history.looks, is_light), named_each_day(history)
    return tuple(
        _wear(kind, history.days, amounts[kind], named=bool(named[kind][-1])) for kind in KINDS
    )


def named_each_day(history: History) -> dict[Kind, Bool]:
    """Whether each kind was named on each day, bool (N,), by the days until then.

    A kind that is named stays so while its reading goes to and fro across the amount.
    """
    if len(history.days) < RECENT:
        return {kind: np.zeros(len(history.days), bool) for kind in KINDS}
    windows = np.moveaxis(sliding_window_view(history.looks, RECENT, axis=0), 2, 1)
    amounts = _amounts(windows, _is_light(windows)[:, None])
    lasting = {kind: _lasting(amounts[kind]) for kind in KINDS}
    # Faded markers show the tip where it is not.
    seen = {"gel": lasting["markers"] < LIMITS["markers"]}
    named: dict[Kind, Bool] = {}
    for kind in KINDS:
        begins = (lasting[kind] >= NAMED[kind]) & seen.get(kind, True)
        better = np.quantile(amounts[kind], _MOST, axis=1) < _STAYS * NAMED[kind]
        unseen = np.zeros(RECENT - 1, bool)
        named[kind] = np.concatenate((unseen, _held(begins, better)))
    return named


def _held(begins: Bool, ends: Bool) -> Bool:
    """Whether something has begun and not ended since, bool (N,)."""
    at = np.arange(len(begins))
    begun, ended = (np.maximum.accumulate(np.where(when, at, -1)) for when in (begins, ends))
    return np.asarray(begun > ended)


def _lasting(amounts: F64) -> F64:
    """What most of the latest looks exceed, along the last axis."""
    return np.asarray(np.quantile(amounts, 1 - _MOST, axis=-1))


def words(wear: Wear) -> str:
    """How far a wear has come, and until when its limit is expected to hold, for a person."""
    return f"{_how_far(wear)}; {_until(wear)}"


def _until(wear: Wear) -> str:
    if wear.beyond:
        return "expect larger errors than the calibration stated"
    if wear.limit_day is None:
        return "it does not grow"
    return f"errors are expected to stay as stated until {date_of(wear.limit_day)}"


def date_of(day: int) -> str:
    """The date of a day since 1970, as YYYY-MM-DD."""
    return date.fromordinal(_FIRST_DAY + day).isoformat()


def _how_far(wear: Wear) -> str:
    amount, limit = (shown(wear.kind, value) for value in (wear.amount, LIMITS[wear.kind]))
    match wear.kind:
        case "light":
            return f"the light has lost {amount} on its darkest side, of {limit} that it may"
        case "markers":
            return f"the markers have lost {amount} of their white, of {limit} that they may"
        case "pins":
            return f"{amount} of the pattern is another one, of {limit} that may be"
        case "gel":
            return f"the tip of the skin has sunk or swollen by {amount}, of {limit} that it may"


def shown(kind: Kind, amount: float) -> str:
    """An amount with its unit."""
    return f"{amount:.2f} mm" if kind == "gel" else f"{100 * amount:.0f} %"


def _is_light(looks: F32) -> Bool:
    """Whether the light has gone rather than the white, by the median of looks (..., N, columns),
    (...).
    """
    white, dark = (
        np.median(looks[..., COLUMNS.index(name)], axis=-1) for name in ("white", "dark")
    )
    return np.asarray(dark <= _LIGHT_PART * np.minimum(white, 0))


def _amounts(looks: F32, is_light: Bool) -> dict[Kind, F64]:
    """The amount of each wear in looks (..., N, columns), (..., N)."""
    columns = np.moveaxis(looks.astype(np.float64), -1, 0)
    table = dict(zip(COLUMNS, columns, strict=True))
    # On the side that is darkest now: one lamp of a ring dims one side.
    slope = np.hypot(table["slope_row"], table["slope_col"])
    lost = 1 - np.exp(np.minimum(table["white"] - slope, 0))
    return {
        "light": np.where(is_light, lost, 0),
        "markers": np.where(is_light, 0, lost),
        "pins": table["bent_part"],
        "gel": np.abs(table["sunk_mm"]),
    }


def _wear(kind: Kind, days: I32, amounts: F64, *, named: bool) -> Wear:
    now = float(_lasting(amounts[-RECENT:]))
    per_day = _growth(days, amounts)
    if per_day is None:
        return Wear(kind, now, named, None, None)
    left = max((LIMITS[kind] - now) / per_day, 0.0)
    within = left <= _YEARS_MAX * _DAYS_PER_YEAR
    day = int(days[-1]) + math.ceil(left) if within else None
    return Wear(kind, now, named, per_day * _DAYS_PER_YEAR, day)


def _growth(days: I32, amounts: F64) -> float | None:
    """The median growth per day between all pairs of the latest days (Theil 1950, Sen 1968); None
    if chance could make as many of them grow.
    """
    recent = days > days[-1] - _TREND_DAYS
    t, y = days[recent].astype(np.float64), amounts[recent]
    first, second = np.triu_indices(len(t), 1)
    steps = y[second] - y[first]
    n = len(t)
    deviation = math.sqrt(n * (n - 1) * (2 * n + 5) / 18)
    slope = float(np.median(steps / (t[second] - t[first]))) if len(steps) else 0.0
    return slope if slope > 0 and np.sign(steps).sum() > _SURE * deviation else None
