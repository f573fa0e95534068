"""Which steps the head takes, and what the camera must see at each: decided before anything moves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from tacshade_edge.types import F64

CLEAR_MM = 5.0
"""Above the highest touch: so high the head moves sideways."""

NEAR_MM = 1.0
"""Above the touch: to there it goes in long steps, and no farther in the dry run."""

_LONG_MM, _SHORT_MM = 2.0, 0.5
# A touch may come so much earlier, or be seen so much later, than the stand of the sensor says.
_EARLY_MM, _LATE_MM = 0.35, 0.6


class Expected(Enum):
    """What the camera must see after a step."""

    FREE = "no contact"
    ANYTHING = "anything"
    TOUCHED = "contact"


@dataclass(frozen=True, slots=True)
class Step:
    """One move straight down, and what must be seen after it."""

    z_mm: float
    expected: Expected


def descent(from_z_mm: float, touch_z_mm: float, to_z_mm: float) -> Iterator[Step]:
    """Steps straight down, the last one exactly to `to_z_mm`; none where it is not below `from_z_mm`.

    Parameters
    ----------
    from_z_mm : float
        Where the head is.
    touch_z_mm : float
        Where it must touch by all that is known.
    to_z_mm : float
    """
    z = from_z_mm
    while z > to_z_mm:
        near = touch_z_mm + NEAR_MM
        z = max(z - _LONG_MM, near, to_z_mm) if z > near else max(z - _SHORT_MM, to_z_mm)
        yield Step(z, _expected(z, touch_z_mm))


def search(from_z_mm: float, least_z_mm: float, step_mm: float) -> Iterator[float]:
    """Heights to look at one after the other on the way down, none below the least."""
    for k in range(1, max(math.floor((from_z_mm - least_z_mm) / step_mm), 0) + 1):
        yield from_z_mm - k * step_mm


def segments(from_mm: F64, to_mm: F64, longest_mm: float) -> tuple[F64, ...]:
    """Ends of the equal parts of a straight move, none longer than this; the last is `to_mm` itself."""
    parts = max(math.ceil(math.dist(from_mm, to_mm) / longest_mm), 1)
    return (*(from_mm + (to_mm - from_mm) * (k / parts) for k in range(1, parts)), to_mm)


def _expected(z_mm: float, touch_z_mm: float) -> Expected:
    if z_mm >= touch_z_mm + _EARLY_MM:
        return Expected.FREE
    return Expected.TOUCHED if z_mm <= touch_z_mm - _LATE_MM else Expected.ANYTHING
