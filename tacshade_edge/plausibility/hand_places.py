"""Places of a hand's fingers against each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations
from typing import Final

from tacshade_edge.plausibility.suspicions import Suspicion, SuspicionCode, suspicion
from tacshade_edge.plausibility.units import LENGTHS, UnitName

CLOSE_MM: Final = 1.0
"""Two sensors that are not at the same place stand farther apart, however small they are."""
APART_MM: Final = 2000.0
"""No hand is that large."""


def judge_fingers(
    places_mm: Mapping[str, tuple[float, float, float]], sizes_mm: Mapping[str, float]
) -> tuple[str, Suspicion] | None:
    """A finger's name and what is wrong with its place, judging by those of the others; None if
    nothing is. `sizes_mm`: the radius of each dome, as far as known.

    Fingers at one and the same place are not judged: nobody has measured them yet.
    """
    found = None
    for (other, at0), (name, at) in combinations(places_mm.items(), 2):
        apart_mm = math.dist(at0, at)
        if apart_mm > APART_MM:
            values = {"apart_mm": apart_mm, "other": other, "unit": UnitName.MICROMETRE}
            return name, suspicion(SuspicionCode.FINGERS_APART, impossible=True, **values)
        # Two domes that touch stand both radii apart, less the depths to which they press.
        least_mm = max(CLOSE_MM, sum(sizes_mm.get(one, 0.0) for one in (other, name)) / 2)
        if not 0 < apart_mm < least_mm:
            continue
        if found is None or apart_mm < CLOSE_MM:
            unit = _unit(apart_mm, least_mm)
            found = (
                name,
                suspicion(
                    SuspicionCode.FINGERS_CLOSE,
                    impossible=apart_mm < CLOSE_MM,
                    apart_mm=apart_mm,
                    other=other,
                    unit=unit,
                ),
            )
    return found


def _unit(apart_mm: float, least_mm: float) -> UnitName | None:
    """The smallest unit in which sensors do not overlap."""
    larger = sorted((size, unit) for unit, size in LENGTHS.items() if size > 1)
    if apart_mm < CLOSE_MM:
        return UnitName.M
    return next((unit for size, unit in larger if apart_mm * size >= least_mm), None)
