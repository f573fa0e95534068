"""Refit the learned inverse to known presses in closed form.

A network trained on many sensors is off on a given one by a nearly constant factor. Each press shows the factor where
the indenter's surface is known and the network sees contact. The mean of the logarithms is robust against wrong presses
(P. J. Huber, Ann. Math. Stat. 35, 1964) and shrinks towards 0 as their spread allows. Balls show little more:
corrections by depth and place fit the balls better, but not other shapes (tools/training/README.md).
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
"""Standard deviation of log factor over sensors; RMS over simulated ones of both families and finer pitch is 0.17."""
# Least standard deviation of log factor over the presses of a sensor.
_LEAST_DEVIATION = 0.05
_HUBER, _ITERATIONS = 1.5, 20
# Fewer cells make no usable contact, fewer presses no usable factor.
LEAST_CELLS, LEAST_PRESSES = 12, 5
# Cells count only where the network and the indenter are deeper than this (mm on the nominal skin).
LEAST_FOUND_MM, LEAST_TRUE_MM = 0.05, 0.1
# The error of h grows with depth; beyond this depth it is mostly proportional (mm on the nominal skin).
PROPORTIONAL_MM = 0.5
# No known sensor needs a factor outside this range.
FACTOR_RANGE = (0.3, 3.0)


@dataclass(frozen=True, slots=True)
class Ball:
    """A pressed ball: its centre in the sensor frame, and its radius."""

    x_mm: float
    y_mm: float
    z_mm: float
    radius_mm: float

    def depth_max_mm(self, skin_radius_mm: float) -> float:
        """Greatest h of the skin under it, mm."""
        return skin_radius_mm - math.hypot(self.x_mm, self.y_mm, self.z_mm) + self.radius_mm


Placed = Ball | PlacedIndenter
"""Any indenter in its place."""


@dataclass(frozen=True, slots=True, eq=False)
class PressRows:
    """One press in the regression, at the cells used: weighted `target` should equal the factor times `found`."""

    found: F64
    target: F64


def stated_ball(geometry: Geometry, x_mm: float, y_mm: float, depth_mm: float, radius_mm: float) -> Ball:
    """Place a ball pressed along -z (docs/reference/calibration-files.md defines its depth)."""
    beside = max(geometry.skin_radius_mm**2 - x_mm**2 - y_mm**2, 0.0)
    return Ball(x_mm, y_mm, math.sqrt(beside) - depth_mm + radius_mm, radius_mm)


def located_ball(geometry: Geometry, inverse: Inverse, depth_mm: float, radius_mm: float) -> Ball | None:
    """Place a ball without stated x and y; None if the network hardly sees a contact."""
    along = contact_direction(geometry, inverse)
    return None if along is None else ball_along(geometry, along, depth_mm, radius_mm)


def contact_direction(geometry: Geometry, inverse: Inverse) -> F64 | None:
    """The unit vector from O to the middle of the contact; None if there is hardly a contact."""
    rays = disc_rays(disc_map.map_grid(geometry.disc, len(inverse.height_mm)), geometry)
    contact = (inverse.contact_logit > 0) & rays.inside
    if np.count_nonzero(contact) < LEAST_CELLS:
        return None
    points = skin_points(np.maximum(inverse.height_mm, 0), rays, geometry)
    middle = points[contact].astype(np.float64).mean(axis=0)
    return np.asarray(middle / np.linalg.norm(middle))


def ball_along(geometry: Geometry, along: F64, depth_mm: float, radius_mm: float) -> Ball:
    """Place a ball in the direction from O of the middle of its contact, which is also that of its centre."""
    reach = geometry.skin_radius_mm - depth_mm + radius_mm
    for _ in range(8):
        x, y = reach * along[0], reach * along[1]
        reach = stated_ball(geometry, x, y, depth_mm, radius_mm).z_mm / along[2]
    return stated_ball(geometry, float(reach * along[0]), float(reach * along[1]), depth_mm, radius_mm)


def placed_ball(geometry: Geometry, inverse: Inverse, press: KnownPress, radius_mm: float) -> Ball | None:
    """Place the ball of a press at its stated place, or locate it; None if that fails."""
    if press.x_mm is None or press.y_mm is None:
        return located_ball(geometry, inverse, press.depth_mm, radius_mm)
    return stated_ball(geometry, press.x_mm, press.y_mm, press.depth_mm, radius_mm)


def ball_height(geometry: Geometry, ball: Ball, cells: int = disc_map.CELLS) -> F32:
    """Height h of the ball's surface at the map's cells, mm; NaN outside the disc and where the ray misses the ball."""
    rays = disc_rays(disc_map.map_grid(geometry.disc, cells), geometry)
    height = ball_height_along(geometry, ball, rays.u.astype(np.float64), rays.v.astype(np.float64))
    return np.where(rays.inside, height, np.nan).astype(np.float32)


def ball_height_along(geometry: Geometry, ball: Ball, u: F64, v: F64) -> F64:
    """Height h of the ball's surface along rays (u, v) of `DiscRays`, any shape, mm; NaN where a ray misses it.

    Computed by components, because numpy sums over an axis of three many times slower.
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
    """Height h of an indenter at the map's cells, mm; NaN or below 0 where it is not inside the undeformed skin."""
    if isinstance(placed, Ball):
        return ball_height(geometry, placed, cells)
    return placed.height_mm(disc_rays(disc_map.map_grid(geometry.disc, cells), geometry), geometry)


def press_rows(inverse: Inverse, geometry: Geometry, placed: Placed) -> PressRows | None:
    """Make the rows of a press for `fit_factor`; None if the network's contact and the indenter hardly overlap."""
    height, scale = inverse.height_mm, skin_scale(geometry)
    truth, use = known_cells(inverse, geometry, placed)
    cells = int(np.count_nonzero(use))
    if cells < LEAST_CELLS:
        return None
    # All presses count alike, except that deep ones count a little less: their error in mm is larger.
    depth_mm = placed.depth_max_mm(geometry.skin_radius_mm) / scale
    weight = 1 / math.sqrt(cells * (PROPORTIONAL_MM + depth_mm))
    return PressRows(height[use].astype(np.float64) * weight, truth[use].astype(np.float64) * weight)


def known_cells(inverse: Inverse, geometry: Geometry, placed: Placed) -> tuple[F32, Bool]:
    """`known_height` of an indenter, and the cells where it overlaps the network's contact."""
    height, truth = inverse.height_mm, known_height(geometry, placed, len(inverse.height_mm))
    scale = skin_scale(geometry)
    use = (inverse.contact_logit > 0) & np.isfinite(height)
    use &= (height > LEAST_FOUND_MM * scale) & (np.nan_to_num(truth) > LEAST_TRUE_MM * scale)
    return truth, use


def fit_factor(presses: Sequence[PressRows]) -> float | None:
    """Fit the factor on h by a robust mean over presses and a prior; None if there are too few presses."""
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
