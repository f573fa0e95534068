"""The closed-form refit of the learned inverse to ball presses.

A network trained on every sensor is off on a given one by a nearly constant factor, which changes a little with
depth and with the distance from the middle. That factor is fitted where the ball's surface is known and the network
sees contact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core import discmap
from tacshade_edge.core.disc import disc_rays
from tacshade_edge.core.skin import skin_points
from tacshade_edge.core.solvers.learned import Inverse
from tacshade_edge.types import F32, F64, Geometry

# Pull towards "as it is", and how much less the plain factor is pulled.
RIDGE, RIDGE_FACTOR = 0.03, 0.003
# Balls tell the factor of other shapes only to about a tenth: corrections that small are noise (log factor).
DOUBT = 0.1
# A contact of fewer cells says nothing; fewer presses neither.
LEAST_CELLS, LEAST_PRESSES = 12, 5
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


@dataclass(frozen=True, slots=True, eq=False)
class PressRows:
    """One press in the regression: `target` is to be `rows` times the weights; cells that are used."""

    rows: F64
    target: F64


def stated_ball(geometry: Geometry, x_mm: float, y_mm: float, depth_mm: float, radius_mm: float) -> Ball:
    """Place a ball that was pressed along -z (docs/calibration.md says what its depth is)."""
    beside = max(geometry.skin_radius_mm**2 - x_mm**2 - y_mm**2, 0.0)
    return Ball(x_mm, y_mm, math.sqrt(beside) - depth_mm + radius_mm, radius_mm)


def located_ball(geometry: Geometry, inverse: Inverse, depth_mm: float, radius_mm: float) -> Ball | None:
    """The same where x and y were not stated: the contact's middle lies on the line from O to the ball's centre."""
    rays = disc_rays(discmap.map_grid(geometry.disc), geometry)
    touched = (inverse.contact_logit > 0) & rays.inside
    if np.count_nonzero(touched) < LEAST_CELLS:
        return None
    points, _ = skin_points(np.maximum(inverse.height_mm, 0), rays, geometry)
    middle = points[touched].astype(np.float64).mean(axis=0)
    along = middle / np.linalg.norm(middle)
    reach = geometry.skin_radius_mm - depth_mm + radius_mm
    for _ in range(8):
        x, y = reach * along[0], reach * along[1]
        reach = stated_ball(geometry, x, y, depth_mm, radius_mm).z_mm / along[2]
    return stated_ball(geometry, float(reach * along[0]), float(reach * along[1]), depth_mm, radius_mm)


def ball_height(geometry: Geometry, ball: Ball) -> F32:
    """H of the ball's surface at the map's cells, mm; NaN where the cell's ray misses it and outside the disc."""
    rays = disc_rays(discmap.map_grid(geometry.disc), geometry)
    u, v = rays.u.astype(np.float64), rays.v.astype(np.float64)
    if geometry.camera_distance_mm is None:
        origin = np.stack((u, v, np.zeros_like(u)), axis=-1)
        along = np.broadcast_to(np.array((0.0, 0.0, 1.0)), origin.shape)
    else:
        origin = np.broadcast_to(np.array((0.0, 0.0, -geometry.camera_distance_mm)), (*u.shape, 3))
        along = np.stack((u, v, np.ones_like(u)), axis=-1)
        along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    offset = np.array((ball.x_mm, ball.y_mm, ball.z_mm)) - origin
    foot = np.sum(offset * along, axis=-1)
    inside = ball.radius_mm**2 - (np.sum(offset * offset, axis=-1) - foot * foot)
    s = foot - np.sqrt(np.where(inside > 0, inside, np.nan))
    height = geometry.skin_radius_mm - np.linalg.norm(origin + s[..., None] * along, axis=-1)
    return np.where(rays.inside, height, np.nan).astype(np.float32)


def press_rows(inverse: Inverse, known: F32, geometry: Geometry, ball: Ball) -> PressRows | None:
    """One press for `fit_refit`; None where the network's contact and the ball hardly meet."""
    height, truth = inverse.height_mm, ball_height(geometry, ball)
    use = (inverse.contact_logit > 0) & (height > 0.05) & (np.nan_to_num(truth) > 0.1)
    cells = int(np.count_nonzero(use))
    if cells < LEAST_CELLS:
        return None
    # Every press counts alike, a deep one a little less: its error in mm is larger.
    weight = 1 / math.sqrt(cells * (0.5 + ball.depth_max_mm(geometry.skin_radius_mm)))
    found = height[use].astype(np.float64)
    rows = _features(found, _rho2(known)[use], float(found.max())) * (found * weight)[:, None]
    return PressRows(rows, truth[use].astype(np.float64) * weight)


def fit_refit(presses: Sequence[PressRows]) -> F32:
    """Weights of the factor by ridge regression; empty where the presses are too few.

    Returns
    -------
    float32 (6,) or (0,)
    """
    if len(presses) < LEAST_PRESSES:
        return np.zeros(0, dtype=np.float32)
    rows = np.concatenate([press.rows for press in presses])
    target = np.concatenate([press.target for press in presses])
    prior = np.zeros(rows.shape[1])
    prior[0] = 1.0
    pull = RIDGE * len(presses) * np.diag([RIDGE_FACTOR] + [1.0] * (rows.shape[1] - 1))
    weights = np.linalg.solve(rows.T @ rows + pull, rows.T @ target + pull @ prior)
    # The first feature is 1, so the first column is the network's own h.
    factors = [float(p.rows[:, 0] @ p.target) / float(p.rows[:, 0] @ p.rows[:, 0]) for p in presses]
    typical = math.log(max(float(np.median(factors)), 1e-3))
    trust = typical**2 / (typical**2 + DOUBT**2)
    return np.asarray(prior + trust * (weights - prior), dtype=np.float32)


def apply_refit(weights: F32, height_mm: F32, known: F32) -> F32:
    """The height map times the fitted factor; as it is without weights."""
    if weights.size == 0:
        return height_mm
    top = max(float(height_mm.max()), 1e-3)
    factor = np.clip(_features(height_mm.astype(np.float64), _rho2(known), top) @ weights, *FACTOR_RANGE)
    return (height_mm * factor).astype(np.float32)


def _rho2(known: F32) -> F64:
    """ρ² of the cells from `discmap.geometry_maps`."""
    rho2: F64 = (known[0].astype(np.float64)) ** 2 + known[1] ** 2
    return np.minimum(rho2, 1.0)


def _features(height_mm: F64, rho2: F64, top_mm: float) -> F64:
    """What the factor may depend on: h, ρ² and the frame's greatest h; (..., 6)."""
    h = height_mm / 3
    t = np.full_like(h, top_mm / 3)
    return np.stack((np.ones_like(h), h, rho2, h * rho2, t, 1 / (0.3 + t)), axis=-1)
