"""The cells of the disc map and the chart of the simulator's skin, each seen from the other. Pure.

The skin's mechanics are the simulator's own (`lab.simulator.skin`), on a coarser grid: its nodes
are about as far apart as the cells.
"""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from tacshade_edge.lab.mjcf.taxels import Taxels
from tacshade_edge.lab.simulator.skin import (
    Skin,
    at_height,
    bilinear,
    chart_to_direction,
    direction_to_chart,
    node_directions,
    undeformed,
)
from tacshade_edge.sensor.geometry.disc import DiscRays, Grid, disc_rays, skin_points
from tacshade_edge.types import F32, F64, Bool, Geometry, frozen

STEPS_PER_SIZE: Final = 32
_LEAST_SHARE = 0.5
"""Of the cells around a node that an object must reach for the node to feel it."""
_TOUCHING_MM = 0.03
_SEEN_STEPS, _SEEN_TOLERANCE_MM, _DAMPED_FROM = 8, 1e-3, 3


@frozen
class SkinView:
    """A sensor's undeformed skin, its camera's rays to the cells in the disc, and for each node of
    the skin's chart its row and column among the cells.
    """

    geometry: Geometry
    grid: Grid
    flat: Skin
    rays: DiscRays
    row: F32
    col: F32


def view_of(geometry: Geometry, taxels: Taxels, form_mm: tuple[float, float]) -> SkinView:
    """See a skin of this radius and size (`SensorModel.form_mm`) at a sensor's taxels."""
    radius_mm, size_mm = form_mm
    flat = undeformed(radius_mm, size_mm, STEPS_PER_SIZE)
    direction = node_directions(radius_mm, size_mm, STEPS_PER_SIZE).astype(np.float64)
    rays, inside = disc_rays(taxels.grid, geometry), taxels.inside
    seen = DiscRays(inside=inside[inside], u=rays.u[inside], v=rays.v[inside])
    row, col = _cells_at(geometry, taxels.grid, at_height(direction, np.zeros(1), radius_mm))
    return SkinView(geometry, taxels.grid, flat, seen, row, col)


def _cells_at(geometry: Geometry, grid: Grid, points_mm: F64) -> tuple[F32, F32]:
    """Rows and columns (...) among the cells of points (..., 3)."""
    x, y, z = np.moveaxis(points_mm, -1, 0)
    d_mm, disc = geometry.camera_distance_mm, geometry.disc
    px_per_mm = 1 / geometry.mm_per_px if d_mm is None else geometry.f_px / (z + d_mm)
    row = (disc.row_c + y * px_per_mm - grid.row0) / grid.step_px
    col = (disc.col_c + x * px_per_mm - grid.col0) / grid.step_px
    return row.astype(np.float32), col.astype(np.float32)


def at_nodes(view: SkinView, reached_mm: F32) -> F32:
    """How far objects reach in at the chart's nodes, from `reach.reached_mm`."""
    return _reached_at(reached_mm, view.row, view.col)


def _reached_at(reached_mm: F32, row: F32, col: F32) -> F32:
    """The mean of the reached cells around places, if they are half of them or more."""
    share, total = (
        cv2.remap(each, col, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        for each in ((reached_mm > 0).astype(np.float32), reached_mm)
    )
    at = np.where(share >= _LEAST_SHARE, total / np.maximum(share, _LEAST_SHARE), 0)
    return np.asarray(at.reshape(row.shape), np.float32)


def seen(view: SkinView, skin: Skin, reached_mm: F32, near: F32) -> tuple[F32, F64]:
    """Heights (N,) of the deformed skin at the cells in the disc, and its points there (N, 3), from
    heights that may be near. No skin is where objects reach, which cells know more finely than
    nodes.
    """
    height = near
    for step in range(_SEEN_STEPS):
        # The ray meets another place of the skin once it is known to be pressed in.
        x, y = chart(skin, _points(view, height))
        found = np.maximum(skin.sample(x, y), 0).astype(np.float32)
        change = float(np.abs(found - height).max(initial=0))
        # On a steep flank it would jump to and fro.
        height = found if step < _DAMPED_FROM else (found + height) * np.float32(0.5)
        if change < _SEEN_TOLERANCE_MM:
            break
    at_rest = at_height(chart_to_direction(x, y, skin.radius_mm), np.zeros(1), skin.radius_mm)
    reached = _reached_at(reached_mm, *_cells_at(view.geometry, view.grid, at_rest))
    height = np.maximum(height, reached)
    return height, _points(view, height)


def chart(skin: Skin, points_mm: F64) -> tuple[F64, F64]:
    """Chart coordinates in mm of points (N, 3)."""
    return direction_to_chart(points_mm, skin.radius_mm)


def touching(skin: Skin, most_mm: F32, points_mm: F64) -> Bool:
    """Which of the skin's points (N, 3) touch what reaches in at most by `most_mm` at the chart's
    nodes.
    """
    x, y = chart(skin, points_mm)
    reach = bilinear(most_mm, x / skin.step_mm, y / skin.step_mm)
    return np.asarray((reach > 0) & (skin.sample(x, y) <= reach + _TOUCHING_MM))


def _points(view: SkinView, height: F32) -> F64:
    return skin_points(height, view.rays, view.geometry).astype(np.float64)


def full(inside: Bool, values: F32, outside: float) -> F32:
    """Values (N, ...) of the cells in the disc on the whole grid, (rows, cols, ...)."""
    grid = np.full((*inside.shape, *values.shape[1:]), np.float32(outside))
    grid[inside] = values
    return grid


def over_skin(x_y_mm: F64, radius_mm: float) -> tuple[float, float]:
    """A place (2,) on the skin, or the nearest one just inside a dome's equator."""
    x, y = x_y_mm.tolist()
    most = math.inf if math.isinf(radius_mm) else 0.9 * radius_mm
    part = min(1.0, most / max(math.hypot(x, y), 1e-9))
    return x * part, y * part
