"""The closed-form refit of the learned inverse to known presses.

A network trained on every sensor is off on a given one by a nearly constant factor. Each press shows it where the
indenter's surface is known and the network sees contact. The logarithms are averaged robustly, so that wrong presses
hardly move the factor, and drawn to 0 as far as their spread leaves it open. Balls show little more: corrections that
also depend on depth and place fit the balls better, and other shapes no better (tools/training/README.md).

References
----------
P. J. Huber, "Robust estimation of a location parameter", Ann. Math. Stat. 35, 1964.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.indenters.indenter import PlacedIndenter
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.core.depth.learned import Inverse
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.back_projection import skin_points
from tacshade_edge.core.geometry.disc import disc_rays
from tacshade_edge.types import F32, F64, Bool, Geometry

PRIOR_DEVIATION = 0.2
"""Standard deviation of log factor over sensors; over simulated ones of both families and finer pitch, RMS is 0.17."""
# The standard deviation of log factor over the presses of a sensor is at least this.
_LEAST_DEVIATION = 0.05
_HUBER, _ITERATIONS = 1.5, 20
# A contact of fewer cells says nothing; fewer presses neither.
LEAST_CELLS, LEAST_PRESSES = 12, 5
# Where the network and the ball are less deep than this, a cell says nothing (mm on the nominal skin).
LEAST_FOUND_MM, LEAST_TRUE_MM = 0.05, 0.1
# Error of h grows with depth; from this depth on it is mostly proportional (mm on the nominal skin).
PROPORTIONAL_MM = 0.5
# No sensor is farther from the network's idea of it.
FACTOR_RANGE = (0.3, 3.0)


@dataclass(frozen=True, slots=True)
class Ball:
    """Where a pressed ball is, in the sensor frame."""

    x_mm: float
    y_mm: float
    z_mm: float
    radius_mm: float

    def depth_max_mm(self, skin_radius_mm: float) -> float:
        """Greatest h of the skin under it."""
        return skin_radius_mm - math.hypot(self.x_mm, self.y_mm, self.z_mm) + self.radius_mm


Placed = Ball | PlacedIndenter
"""What is pressed, where it is."""


@dataclass(frozen=True, slots=True, eq=False)
class PressRows:
    """One press in the regression, at the cells that are used: `target` is to be the factor times `found`, weighted."""

    found: F64
    target: F64


def stated_ball(geometry: Geometry, x_mm: float, y_mm: float, depth_mm: float, radius_mm: float) -> Ball:
    """Place a ball that was pressed along -z (docs/reference/calibration-files.md says what its depth is)."""
    beside = max(geometry.skin_radius_mm**2 - x_mm**2 - y_mm**2, 0.0)
    return Ball(x_mm, y_mm, math.sqrt(beside) - depth_mm + radius_mm, radius_mm)


def located_ball(geometry: Geometry, inverse: Inverse, depth_mm: float, radius_mm: float) -> Ball | None:
    """The same where x and y were not stated; None where the network sees hardly a contact."""
    along = contact_direction(geometry, inverse)
    return None if along is None else ball_along(geometry, along, depth_mm, radius_mm)


def contact_direction(geometry: Geometry, inverse: Inverse) -> F64 | None:
    """From O to the middle of the contact, a unit vector; None where there is hardly one."""
    rays = disc_rays(disc_map.map_grid(geometry.disc, len(inverse.height_mm)), geometry)
    contact = (inverse.contact_logit > 0) & rays.inside
    if np.count_nonzero(contact) < LEAST_CELLS:
        return None
    points = skin_points(np.maximum(inverse.height_mm, 0), rays, geometry)
    middle = points[contact].astype(np.float64).mean(axis=0)
    return np.asarray(middle / np.linalg.norm(middle))


def ball_along(geometry: Geometry, along: F64, depth_mm: float, radius_mm: float) -> Ball:
    """Place a ball whose contact's middle lies in a direction from O: so does the ball's centre."""
    reach = geometry.skin_radius_mm - depth_mm + radius_mm
    for _ in range(8):
        x, y = reach * along[0], reach * along[1]
        reach = stated_ball(geometry, x, y, depth_mm, radius_mm).z_mm / along[2]
    return stated_ball(geometry, float(reach * along[0]), float(reach * along[1]), depth_mm, radius_mm)


def placed_ball(geometry: Geometry, inverse: Inverse, press: KnownPress, radius_mm: float) -> Ball | None:
    """Place the ball of a press where it is stated, or located; None where it cannot be."""
    if press.x_mm is None or press.y_mm is None:
        return located_ball(geometry, inverse, press.depth_mm, radius_mm)
    return stated_ball(geometry, press.x_mm, press.y_mm, press.depth_mm, radius_mm)


def ball_height(geometry: Geometry, ball: Ball, cells: int = disc_map.CELLS) -> F32:
    """H of the ball's surface at the map's cells, mm; NaN where the cell's ray misses it and outside the disc."""
    rays = disc_rays(disc_map.map_grid(geometry.disc, cells), geometry)
    height = ball_height_along(geometry, ball, rays.u.astype(np.float64), rays.v.astype(np.float64))
    return np.where(rays.inside, height, np.nan).astype(np.float32)


def ball_height_along(geometry: Geometry, ball: Ball, u: F64, v: F64) -> F64:
    """H of the ball's surface along the rays (u, v) of `DiscRays`, of any shape, mm; NaN where a ray misses it.

    By components: numpy sums over an axis of three many times as slowly.
    """
    if geometry.camera_distance_mm is None:
        origin = (u, v, np.zeros_like(u))
        along = (np.zeros_like(u), np.zeros_like(u), np.ones_like(u))
    else:
        origin = (np.zeros_like(u), np.zeros_like(u), np.full_like(u, -geometry.camera_distance_mm))
        length = np.sqrt(u * u + v * v + 1)
        along = (u / length, v / length, 1 / length)
    offset = (ball.x_mm - origin[0], ball.y_mm - origin[1], ball.z_mm - origin[2])
    foot = _dot(offset, along)
    inside = ball.radius_mm**2 - (_dot(offset, offset) - foot * foot)
    s = foot - np.sqrt(np.where(inside > 0, inside, np.nan))
    met = (origin[0] + s * along[0], origin[1] + s * along[1], origin[2] + s * along[2])
    return np.asarray(geometry.skin_radius_mm - np.sqrt(_dot(met, met)))


def _dot(a: tuple[F64, F64, F64], b: tuple[F64, F64, F64]) -> F64:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def known_height(geometry: Geometry, placed: Placed, cells: int = disc_map.CELLS) -> F32:
    """H of what is pressed at the map's cells, mm; NaN or below 0 where it is not inside the undeformed skin."""
    if isinstance(placed, Ball):
        return ball_height(geometry, placed, cells)
    return placed.height_mm(disc_rays(disc_map.map_grid(geometry.disc, cells), geometry), geometry)


def press_rows(inverse: Inverse, geometry: Geometry, placed: Placed) -> PressRows | None:
    """One press for `fit_factor`; None where the network's contact and the indenter hardly meet."""
    height, scale = inverse.height_mm, skin_scale(geometry)
    truth, use = known_cells(inverse, geometry, placed)
    cells = int(np.count_nonzero(use))
    if cells < LEAST_CELLS:
        return None
    # Every press counts alike, a deep one a little less: its error in mm is larger.
    depth_mm = placed.depth_max_mm(geometry.skin_radius_mm) / scale
    weight = 1 / math.sqrt(cells * (PROPORTIONAL_MM + depth_mm))
    return PressRows(height[use].astype(np.float64) * weight, truth[use].astype(np.float64) * weight)


def known_cells(inverse: Inverse, geometry: Geometry, placed: Placed) -> tuple[F32, Bool]:
    """H of what is pressed as `known_height`, and the cells where the network's contact and the indenter meet."""
    height, truth = inverse.height_mm, known_height(geometry, placed, len(inverse.height_mm))
    scale = skin_scale(geometry)
    use = (inverse.contact_logit > 0) & np.isfinite(height)
    use &= (height > LEAST_FOUND_MM * scale) & (np.nan_to_num(truth) > LEAST_TRUE_MM * scale)
    return truth, use


def fit_factor(presses: Sequence[PressRows]) -> float | None:
    """The factor on h by a robust mean over presses and a prior; None where the presses are too few."""
    if len(presses) < LEAST_PRESSES:
        return None
    squares = np.array([float(press.found @ press.found) for press in presses])
    ratios = np.array([float(press.found @ press.target) for press in presses]) / squares
    logs = np.log(np.maximum(ratios, np.finfo(float).tiny))
    middle = _weighted_median(logs, squares)
    deviation = max(1.4826 * _weighted_median(np.abs(logs - middle), squares), _LEAST_DEVIATION)
    for _ in range(_ITERATIONS):
        weight = squares * np.minimum(1, _HUBER * deviation / np.maximum(np.abs(logs - middle), 1e-9))
        middle = float(weight @ logs / weight.sum())
    effective_presses = float(weight.sum() ** 2 / (weight @ weight))
    drawn = 1 / (1 + (deviation / PRIOR_DEVIATION) ** 2 / effective_presses)
    return min(max(math.exp(drawn * middle), FACTOR_RANGE[0]), FACTOR_RANGE[1])


def _weighted_median(values: F64, weights: F64) -> float:
    order = np.argsort(values)
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, 0.5 * below[-1])])
