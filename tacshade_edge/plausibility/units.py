"""Units that people write in place of the expected ones, and the one that a factor resembles."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import StrEnum
from typing import Final


class UnitName(StrEnum):
    """A unit by its symbol."""

    M = "m"
    CM = "cm"
    INCH = "inches"
    MICROMETRE = "µm"
    RADIAN = "radians"
    TURN = "turns"
    MILLIRADIAN = "mrad"
    SECOND = "s"
    MILLISECOND = "ms"
    MICROSECOND = "µs"
    HUNDRED_NS = "100 ns"
    PICOSECOND = "ps"


LENGTHS: Final[Mapping[UnitName, float]] = {
    UnitName.CM: 10.0,
    UnitName.INCH: 25.4,
    UnitName.M: 1000.0,
    UnitName.MICROMETRE: 1e-3,
}
"""Millimetres in each."""
ANGLES: Final[Mapping[UnitName, float]] = {
    UnitName.RADIAN: math.degrees(1),
    UnitName.TURN: 360.0,
    UnitName.MILLIRADIAN: math.degrees(1e-3),
}
"""Degrees in each."""
TIMES: Final[Mapping[UnitName, float]] = {
    UnitName.SECOND: 1e9,
    UnitName.MILLISECOND: 1e6,
    UnitName.MICROSECOND: 1e3,
    UnitName.HUNDRED_NS: 100.0,
    UnitName.PICOSECOND: 1e-3,
}
"""Nanoseconds in each."""


def nearest(
    factor: float, units: Mapping[UnitName, float], within: float = math.inf
) -> UnitName | None:
    """The unit whose size is nearest to `factor` times the expected one's; None if none is within
    that ratio.
    """
    if not factor > 0:
        return None
    unit = min(units, key=lambda one: abs(math.log(units[one] / factor)))
    return unit if abs(math.log(units[unit] / factor)) <= math.log(within) else None
