"""The closed-form refit of the learned inverse to ball presses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core import discmap
from tacshade_edge.core.disc import disc_rays
from tacshade_edge.types import F32, F64, Geometry

RIDGE = 0.003
LEAST_CELLS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Refit:
    """h becomes h · (features · weights)."""

    weights: F64


def features(height_mm: F64, rho2: F64, top_mm: F64 | float) -> F64:
    """Features of a cell, its h, its ρ² and the greatest h of the frame: (..., 6)."""
    h, t = height_mm / 3, np.broadcast_to(np.asarray(top_mm) / 3, np.shape(height_mm))
    one = np.ones_like(h)
    return np.stack((one, h, rho2, h * rho2, t, 1 / (0.3 + t)), axis=-1)


def ball_height(geometry: Geometry, x_mm: float, y_mm: float, depth_mm: float, radius_mm: float) -> F32:
    """H of a ball's surface at the map's cells; NaN where the cell's ray misses it."""
    r = geometry.skin_radius_mm
    centre = np.array((x_mm, y_mm, np.sqrt(r * r - x_mm**2 - y_mm**2) - depth_mm + radius_mm))
    rays = disc_rays(discmap.map_grid(geometry.disc), geometry)
    if geometry.camera_distance_mm is None:
        origin = np.stack((rays.u, rays.v, np.zeros_like(rays.u)), axis=-1)
        along = np.broadcast_to(np.array((0.0, 0.0, 1.0)), origin.shape)
    else:
        origin = np.broadcast_to(np.array((0.0, 0.0, -geometry.camera_distance_mm)), (*rays.u.shape, 3))
        along = np.stack((rays.u, rays.v, np.ones_like(rays.u)), axis=-1)
        along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    offset = centre - origin
    foot = np.sum(offset * along, axis=-1)
    inside = radius_mm**2 - (np.sum(offset * offset, axis=-1) - foot * foot)
    s = foot - np.sqrt(np.where(inside > 0, inside, np.nan))
    height = r - np.linalg.norm(origin + s[..., None] * along, axis=-1)
    return np.where(rays.inside, height, np.nan).astype(np.float32)


def press_rows(
    maps: tuple[F32, F32], known: F32, geometry: Geometry, x_mm: float, y_mm: float, depth_mm: float, radius_mm: float
) -> tuple[F64, F64]:
    """Features (n, 6) and true ratios' targets (n,) of one press: where the network and the ball agree on contact."""
    height, logit = maps
    truth = ball_height(geometry, x_mm, y_mm, depth_mm, radius_mm)
    use = (logit > 0) & (height > 0.05) & np.isfinite(truth) & (truth > 0.1)
    if np.count_nonzero(use) < LEAST_CELLS:
        return np.empty((0, 7)), np.empty(0)
    rho2 = (known[0] ** 2 + known[1] ** 2)[use]
    top = float(height[use].max())
    weight = 1 / np.sqrt(np.count_nonzero(use) * (0.5 + depth_mm))
    h = height[use].astype(float)
    return features(h, rho2, top) * (h * weight)[:, None], truth[use] * weight


def fit_refit(rows: Sequence[tuple[F64, F64]]) -> Refit | None:
    """Ridge regression towards "as it is", every press of the same weight."""
    used = [r for r in rows if len(r[1])]
    if len(used) < 5:
        return None
    a, b = np.concatenate([r[0] for r in used]), np.concatenate([r[1] for r in used])
    prior = np.zeros(a.shape[1])
    prior[0] = 1.0
    pull = RIDGE * len(used) * np.diag([0.03] + [1.0] * (a.shape[1] - 1))
    return Refit(np.linalg.solve(a.T @ a + pull, a.T @ b + pull @ prior))


def apply_refit(refit: Refit, height_mm: F32, known: F32) -> F32:
    """The refitted height map."""
    rho2 = known[0] ** 2 + known[1] ** 2
    top = max(float(height_mm.max()), 1e-3)
    factor = features(height_mm, rho2, top) @ refit.weights
    return (height_mm * np.clip(factor, 0.3, 3.0)).astype(np.float32)
