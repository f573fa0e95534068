"""Check that the stated depths count from the zero that docs/reference/calibration-files.md defines.

A network that never saw this sensor is off by a nearly constant factor (`gain`), so its depths against the true ones
lie on a line through 0. If the stated ones lie on another line, their zero is off. Depths stated as travel from first
touch are off by an amount that grows with the distance from the middle; the share of that amount in the error, 0 or 1,
is a third coefficient. Shallow presses decide, since the error of a depth grows with it. (The weights: P. J. Huber,
"Robust estimation of a location parameter", Ann. Math. Stat. 35, 1964.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tacshade_edge.core.calibration.refit.gain import Ball, Placed
from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.types import F64, Geometry

# An offset counts if it exceeds these mm on the nominal skin and standard deviations, and the line's slope is one that
# the network has on known kinds of sensors. Good tables have 0.26 mm at most. tools/studies/calibration.py measures
# what this finds, rightly and wrongly.
_LEAST_OFFSET_MM, _OFFSET_DEVIATIONS, _SLOPES = 0.3, 3.0, (0.85, 1.15)
# A coefficient above the first value, and this many standard deviations, is a hint that depths are travel from first
# touch; above the third and fourth the table is rejected.
_HINTED_TRAVEL, _HINTED_DEVIATIONS, _SURE_TRAVEL, _SURE_DEVIATIONS = 0.65, 3.0, 0.7, 4.0
# Error of a depth: a part of it, and mm on the nominal skin; and the least deviation relative to that.
_ERROR_PART, _ERROR_MM, _LEAST_DEVIATION = 0.12, 0.15, 0.3
_HUBER, _ITERATIONS = 1.5, 25
# Fewer presses show too little; with fewer than the second, nothing is certain.
_LEAST_PRESSES, _LEAST_SURE = 12, 16
TRAVEL_ADVICE = (
    "pass --depth-from-touch, or state the undeformed skin's z at (x, y) minus the z of the indenter's "
    "lowest point (docs/reference/calibration-files.md)"
)


def zero_hint(found_mm: Sequence[float], placed: Sequence[Placed], geometry: Geometry) -> str:
    """A message about another zero of the depths that fits clearly better than the stated one, judging by the greatest
    h that a network finds in each press without a refit; empty if none does.
    """
    r, scale = geometry.skin_radius_mm, skin_scale(geometry)
    found = np.asarray(found_mm) / scale
    if len(found) < _LEAST_PRESSES or np.ptp(found) == 0:
        return ""
    stated = np.array([at.depth_max_mm(r) for at in placed]) / scale
    share, deviation = _travel_share(found, placed, geometry)
    if share > max(_HINTED_TRAVEL, _HINTED_DEVIATIONS * deviation):
        return f"the stated depths fit better as travel from first touch: {TRAVEL_ADVICE}"
    (slope, offset), (_, deviation) = _robust_fit(np.stack((found, np.ones_like(found)), axis=1), stated)
    beyond = abs(offset) > max(_LEAST_OFFSET_MM, _OFFSET_DEVIATIONS * deviation)
    if not (beyond and _SLOPES[0] < slope < _SLOPES[1]):
        return ""
    change = f"{abs(offset) * scale:.1f} mm {'less' if offset > 0 else 'more'}"
    return f"the depths fit better if all are {change}: check where depth is zero"


def travel_mistake(found_mm: Sequence[float], placed: Sequence[Placed], geometry: Geometry) -> str:
    """A message if the depths are certainly travel from first touch; empty otherwise. Takes what `zero_hint` takes."""
    found = np.asarray(found_mm) / skin_scale(geometry)
    if len(found) < _LEAST_SURE or np.ptp(found) == 0:
        return ""
    share, deviation = _travel_share(found, placed, geometry)
    if share < max(_SURE_TRAVEL, _SURE_DEVIATIONS * deviation):
        return ""
    return f"PRESSES.csv: depth_mm: found travel from first touch, judging by the images: {TRAVEL_ADVICE}"


def _travel_share(found: F64, placed: Sequence[Placed], geometry: Geometry) -> tuple[float, float]:
    """The share of travel from first touch in the stated depths, 0 to 1 plus noise, and its standard deviation."""
    r, scale = geometry.skin_radius_mm, skin_scale(geometry)
    stated = np.array([at.depth_max_mm(r) for at in placed]) / scale
    missing = stated - np.array([_read_as_travel(at, r).depth_max_mm(r) for at in placed]) / scale
    x = np.stack((found, missing, np.ones_like(found)), axis=1)
    if np.linalg.matrix_rank(x) < x.shape[1]:
        return 0.0, math.inf
    coefficients, deviations = _robust_fit(x, stated)
    return float(coefficients[1]), float(deviations[1])


def _robust_fit(x: F64, stated: F64) -> tuple[F64, F64]:
    """Fit coefficients (C,) of the columns of x (N, C), first the network's depths, and their deviations (C,)."""
    trust = 1 / np.hypot(_ERROR_MM, _ERROR_PART * x[:, 0])
    weight = trust * trust
    for _ in range(_ITERATIONS):
        normal = x.T @ (x * weight[:, None])
        coefficients = np.linalg.solve(normal, x.T @ (weight * stated))
        error = np.abs(stated - x @ coefficients) * trust
        deviation = max(1.4826 * float(np.median(error)), _LEAST_DEVIATION)
        weight = trust * trust * np.minimum(1, _HUBER * deviation / np.maximum(error, 1e-9))
    free = len(x) / (len(x) - x.shape[1])
    deviations: F64 = deviation * np.sqrt(free * np.diag(np.linalg.inv(normal)))
    return np.asarray(coefficients, np.float64), deviations


def _read_as_travel(ball: Placed, skin_radius_mm: float) -> Placed:
    """The place of a ball or another indenter if its stated depth is travel from first touch."""
    if not isinstance(ball, Ball):
        return ball.deeper(ball.first_touch_mm(skin_radius_mm))
    beside2 = ball.x_mm**2 + ball.y_mm**2
    skin_z = math.sqrt(max(skin_radius_mm**2 - beside2, 0.0))
    touch_z = math.sqrt(max((skin_radius_mm + ball.radius_mm) ** 2 - beside2, 0.0))
    return Ball(ball.x_mm, ball.y_mm, ball.z_mm + touch_z - ball.radius_mm - skin_z, ball.radius_mm)
