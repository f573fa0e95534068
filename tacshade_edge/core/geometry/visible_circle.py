"""Measure how much of the visible circle's rim is in an image, and fit the circle through three points of the rim."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from tacshade_edge.errors import ConfigError
from tacshade_edge.types import Disc

LEAST_RIM_SEEN = 0.25
"""Least part of the rim in the image; with less, the pattern ends at the image's own border."""

LEAST_RADIUS_PX = 33.0
"""Least radius, two thirds of an image of 100 px: a smaller circle does not show the markers' pitch."""

LEAST_APART = 0.5
"""Least distance between any two of the points, in radii: an error of one moves the rim at most eight times as far."""

_RAYS = 1440
# Twice the area of a triangle that rounding makes of a line, relative to the greatest squared side.
_LINE = 1e-9


def rim_seen(shape: tuple[int, ...], disc: Disc) -> float:
    """Part of a circle's rim, 0 to 1, that lies in an image of a shape (rows, cols)."""
    angles = 2 * np.pi * np.arange(_RAYS) / _RAYS
    rows, cols = disc.row_c + disc.radius_px * np.sin(angles), disc.col_c + disc.radius_px * np.cos(angles)
    return float(np.mean((rows >= 0) & (rows <= shape[0] - 1) & (cols >= 0) & (cols <= shape[1] - 1)))


def circle_through(points_px: Sequence[tuple[float, float]], shape: tuple[int, ...]) -> Disc:
    """The visible circle from three points (row, col) of its rim. Raises ConfigError if they make none that can be
    it.
    """
    for row, col in points_px:
        if not (-0.5 <= row <= shape[0] - 0.5 and -0.5 <= col <= shape[1] - 0.5):
            raise ConfigError(
                f"three points: found a point at row {row:g}, col {col:g}, "
                f"expected a point inside the {shape[1]}x{shape[0]} px image"
            )
    (row0, col0), (row1, col1), (row2, col2) = points_px
    # Relative to the first point, to lose less to rounding.
    r1, c1, r2, c2 = row1 - row0, col1 - col0, row2 - row0, col2 - col0
    twice_area = r1 * c2 - c1 * r2
    if abs(twice_area) <= _LINE * max(r1 * r1 + c1 * c1, r2 * r2 + c2 * c2):
        raise ConfigError("three points: found points on one line, expected points far apart on the dome's rim")
    square1, square2 = r1 * r1 + c1 * c1, r2 * r2 + c2 * c2
    row = (square1 * c2 - square2 * c1) / (2 * twice_area)
    col = (square2 * r1 - square1 * r2) / (2 * twice_area)
    disc = Disc(row0 + row, col0 + col, math.hypot(row, col))
    apart_px = min(math.dist(one, other) for one, other in combinations(points_px, 2))
    if apart_px < LEAST_APART * disc.radius_px:
        raise ConfigError(
            f"three points: found a distance of only {apart_px:.0f} px between two points, "
            f"expected at least {LEAST_APART:g} times the circle's radius of {disc.radius_px:.0f} px"
        )
    if disc.radius_px < LEAST_RADIUS_PX:
        raise ConfigError(
            f"three points: found a circle with a radius of {disc.radius_px:.0f} px, "
            f"expected at least {LEAST_RADIUS_PX:g} px"
        )
    if (seen := rim_seen(shape, disc)) < LEAST_RIM_SEEN:
        raise ConfigError(
            f"three points: found a circle with {100 * seen:.0f} % of its rim in the image, "
            f"expected at least {100 * LEAST_RIM_SEEN:.0f} %"
        )
    return disc
