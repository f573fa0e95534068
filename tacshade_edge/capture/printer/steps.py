"""The steps that the head takes and what the camera must see after each, decided before anything moves."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from tacshade_edge.types import F64

CLEAR_MM = 5.0
"""Height above the highest touch at which the head moves sideways."""

NEAR_MM = 1.0
"""Height above the touch down to which the head takes long steps; the dry run ends there."""

_LONG_MM, _SHORT_MM = 2.0, 0.5
# How much earlier or later the camera may see a touch than the sensor's location predicts.
_EARLY_MM, _LATE_MM = 0.35, 0.6


class Expected(Enum):
    """What the camera must see after a step."""

    FREE = "no contact"
    ANYTHING = "anything"
    TOUCHED = "contact"


@dataclass(frozen=True, slots=True)
class Step:
    """One move straight down, and what the camera must see after it."""

    z_mm: float
    expected: Expected


def descent(from_z_mm: float, touch_z_mm: float, to_z_mm: float) -> Iterator[Step]:
    """Yield steps straight down, the last one exactly to `to_z_mm`; none if that is not below `from_z_mm`.

    Parameters
    ----------
    from_z_mm : float
        Where the head is.
    touch_z_mm : float
        Where the indenter is expected to touch.
    to_z_mm : float
    """
    z = from_z_mm
    while z > to_z_mm:
        near = touch_z_mm + NEAR_MM
        z = max(z - _LONG_MM, near, to_z_mm) if z > near else max(z - _SHORT_MM, to_z_mm)
        yield Step(z, _expected(z, touch_z_mm))


def search(from_z_mm: float, least_z_mm: float, step_mm: float) -> Iterator[float]:
    """Yield the heights at which to look for a touch on the way down, none below `least_z_mm`."""
    for k in range(1, max(math.floor((from_z_mm - least_z_mm) / step_mm), 0) + 1):
        yield from_z_mm - k * step_mm


def segments(from_mm: F64, to_mm: F64, longest_mm: float) -> tuple[F64, ...]:
    """Return the ends of a straight move's equal parts, none longer than `longest_mm`; the last is `to_mm` itself."""
    parts = max(math.ceil(math.dist(from_mm, to_mm) / longest_mm), 1)
    return (*(from_mm + (to_mm - from_mm) * (k / parts) for k in range(1, parts)), to_mm)


def _expected(z_mm: float, touch_z_mm: float) -> Expected:
    if z_mm >= touch_z_mm + _EARLY_MM:
        return Expected.FREE
    return Expected.TOUCHED if z_mm <= touch_z_mm - _LATE_MM else Expected.ANYTHING
