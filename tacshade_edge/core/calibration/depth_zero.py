"""Is the zero of the stated depths the one that docs/calibration-files.md asks for?

A network that never saw this sensor is off by a nearly constant factor (`gain`), so its depths over the true ones lie
on a line through 0. Where the stated ones lie on another line, their zero is off.

References
----------
H. Theil, "A rank-invariant method of linear and polynomial regression analysis", 1950; P. K. Sen, "Estimates of the
regression coefficient based on Kendall's tau", J. Am. Stat. Assoc. 63, 1968: the line, and the interval of its slope.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.gain import Ball, Placed
from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.types import F64, Geometry

# An offset counts where its interval lies beyond so many mm on the nominal skin, and the line's slope is one that the
# network has on sensors of its kind. What this finds, and finds wrongly: tools/bench_calibration.py.
_LEAST_OFFSET_MM, _SLOPES = 0.25, (0.85, 1.15)
# Travel from first touch is hinted at when it leaves less than this part of the error; errors count up to a cap (mm on
# the nominal skin), so that a few wrong presses do not decide.
_TRAVEL_PART, _ERROR_CAP_MM = 0.75, 1.0
# Fewer presses tell too little.
_LEAST_PRESSES = 12
# Of the normal distribution, for an interval of 95 %.
_Z95 = 1.959964


@dataclass(frozen=True, slots=True)
class Line:
    """A robust line: its slope, its value at 0, and that value at the ends of the slope's 95 % interval."""

    slope: float
    offset: float
    offset_low: float
    offset_high: float


def theil_sen(x: F64, y: F64) -> Line:
    """The Theil-Sen line of y over x (float64 (N,), N at least 2, not all x equal)."""
    i, j = np.triu_indices(len(x), 1)
    apart = x[i] != x[j]
    slopes = np.sort((y[j] - y[i])[apart] / (x[j] - x[i])[apart])
    n, pairs = len(x), len(slopes)
    spread = _Z95 * math.sqrt(n * (n - 1) * (2 * n + 5) / 18)
    low = slopes[max(round((pairs - spread) / 2) - 1, 0)]
    high = slopes[min(round((pairs + spread) / 2), pairs - 1)]
    slope, x0, y0 = float(np.median(slopes)), float(np.median(x)), float(np.median(y))
    return Line(slope, y0 - slope * x0, y0 - float(high) * x0, y0 - float(low) * x0)


def zero_hint(found_mm: Sequence[float], placed: Sequence[Placed], geometry: Geometry) -> str:
    """Another zero of the depths that fits clearly better than the stated one, for a person; empty when none does.

    Parameters
    ----------
    found_mm : sequence of float
        Of each press the greatest h that a network finds that was not refitted.
    placed : sequence of Ball or PlacedIndenter
        Where the indenters are by what is stated of them.
    geometry : Geometry
    """
    r, scale = geometry.skin_radius_mm, skin_scale(geometry)
    found = np.asarray(found_mm) / scale
    if len(found) < _LEAST_PRESSES or np.ptp(found) == 0:
        return ""
    stated = np.array([at.depth_max_mm(r) for at in placed]) / scale
    travel = np.array([_read_as_travel(at, r).depth_max_mm(r) for at in placed]) / scale
    line, travel_line = theil_sen(found, stated), theil_sen(found, travel)
    if _error(travel_line, found, travel) < _TRAVEL_PART * _error(line, found, stated):
        return (
            "the stated depths fit better as travel from first touch; depth_mm is the undeformed skin's z at (x, y) "
            "less the z of the indenter's lowest point (docs/calibration-files.md)"
        )
    beyond = line.offset_low > _LEAST_OFFSET_MM or line.offset_high < -_LEAST_OFFSET_MM
    if not (beyond and _SLOPES[0] < line.slope < _SLOPES[1]):
        return ""
    change = f"{abs(line.offset) * scale:.1f} mm {'less' if line.offset > 0 else 'more'}"
    return f"the depths fit better if all are {change}: check the zero of the depth"


def _read_as_travel(ball: Placed, skin_radius_mm: float) -> Placed:
    """Where a ball or another indenter is if its depth was stated as travel from first touch."""
    if not isinstance(ball, Ball):
        return ball.deeper(ball.first_touch_mm(skin_radius_mm))
    beside2 = ball.x_mm**2 + ball.y_mm**2
    skin_z = math.sqrt(max(skin_radius_mm**2 - beside2, 0.0))
    touch_z = math.sqrt(max((skin_radius_mm + ball.radius_mm) ** 2 - beside2, 0.0))
    return Ball(ball.x_mm, ball.y_mm, ball.z_mm + touch_z - ball.radius_mm - skin_z, ball.radius_mm)


def _error(line: Line, x: F64, y: F64) -> float:
    """Mean distance from a line along y."""
    return float(np.mean(np.minimum(np.abs(y - line.offset - line.slope * x), _ERROR_CAP_MM)))
