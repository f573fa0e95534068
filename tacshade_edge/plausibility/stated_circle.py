"""A stated circle of the image against the one that the image shows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from enum import StrEnum
from typing import Final

from tacshade_edge.plausibility.suspicions import Suspicion, SuspicionCode, suspicion

Circle = tuple[float, float, float]
"""Row, column and radius."""
# Of the radius: a reading is right if its middle and radius are this near to those of the circle
# found, and wrong if farther than the second.
_NEAR: Final = 0.12
_FAR: Final = 0.25


class CircleReading(StrEnum):
    """How a circle may have been stated, as a question ends."""

    SWAPPED = "are row and column swapped?"
    FROM_BELOW = "is the row counted from below?"
    SWAPPED_FROM_BELOW = "are row and column swapped, and the row counted from below?"
    CORNER = "is that the corner of the square around the circle?"
    CORNER_SWAPPED = (
        "is that the corner of the square around the circle, with row and column swapped?"
    )
    OTHER_SIZE = "was it measured in an image of another size?"
    MILLIMETRES = "is the radius in mm?"


def judge_circle(
    stated: Circle, found: Circle, height_px: int, radius_mm: float
) -> Suspicion | None:
    """How a stated circle that leaves out what is seen may be meant: as the one found in an image
    of this height; None if in no such way. `radius_mm` is that of the skin's circle.
    """
    if _apart(stated, found) < _FAR:
        return None
    for reading, circle in _readings(stated, found, height_px, radius_mm):
        if _apart(circle, found) < _NEAR:
            row_px, col_px, radius_px = stated
            expected = dict(
                zip(
                    ("expected_row_px", "expected_col_px", "expected_radius_px"), found, strict=True
                )
            )
            return suspicion(
                SuspicionCode.CIRCLE_STATED,
                impossible=True,
                row_px=row_px,
                col_px=col_px,
                radius_px=radius_px,
                reading=reading,
                **expected,
            )
    return None


def _readings(
    stated: Circle, found: Circle, height_px: int, radius_mm: float
) -> Iterator[tuple[CircleReading, Circle]]:
    row, col, radius = stated
    last = height_px - 1
    yield CircleReading.SWAPPED, (col, row, radius)
    yield CircleReading.FROM_BELOW, (last - row, col, radius)
    yield CircleReading.SWAPPED_FROM_BELOW, (last - col, row, radius)
    yield CircleReading.CORNER, (row + radius, col + radius, radius)
    yield CircleReading.CORNER_SWAPPED, (col + radius, row + radius, radius)
    if abs(radius / radius_mm - 1) < _NEAR:
        yield CircleReading.MILLIMETRES, found
    part = found[2] / radius
    yield CircleReading.OTHER_SIZE, (row * part, col * part, radius * part)


def _apart(one: Circle, found: Circle) -> float:
    """The distance of the middles, and of the radii, in radii of the found one."""
    return max(math.dist(one[:2], found[:2]), abs(one[2] - found[2])) / found[2]
