"""Where MuJoCo's tactile sensor samples what touches the skin. Pure.

Each cell has a column of taxels, the first of them outside the skin, so that it tells how far an
object reaches in along the cell's own direction (`reach`).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from tacshade_edge.sensor.geometry.disc import Grid, disc_rays, radius_squared, skin_points
from tacshade_edge.sensor.geometry.disc_map import map_grid
from tacshade_edge.types import F64, I64, Bool, Geometry, frozen

CELLS: Final = 56
"""Cells along a side of the disc map, as in the profile `fast`."""
SHELLS: Final = 9
GAP_PER_SIZE: Final = 1 / 20
"""Distance between shells of taxels, in sizes of the skin: 1 mm on a dome of 20 mm. The shells
reach from one such step outside the skin to seven inside.
"""


@frozen
class Taxels:
    """Columns of taxels below the cells `cell` (N,) of a flattened grid: `points_mm`, float64
    (shells, N, 3), in the sensor frame, `below_mm` (shells,) inside the undeformed skin. `inside`,
    bool (rows, cols), are the cells in the disc.
    """

    grid: Grid
    inside: Bool
    cell: I64
    below_mm: F64
    points_mm: F64


def taxels_of(geometry: Geometry) -> Taxels:
    """Place a sensor's taxels: below the cells of its disc map in the disc, and in a ring around
    it, so that what touches at its edge has an outside.
    """
    grid = map_grid(geometry.disc, CELLS)
    rays = disc_rays(grid, geometry)
    reach = 1 + grid.step_px / geometry.disc.radius_px
    cell = np.flatnonzero(radius_squared(grid, geometry.disc) <= reach * reach)
    flat = np.zeros((grid.rows, grid.cols), np.float32)
    skin = skin_points(flat, rays, geometry).reshape(-1, 3)[cell].astype(np.float64)
    below = np.arange(-1.0, SHELLS - 1, dtype=np.float64) * (geometry.size_mm * GAP_PER_SIZE)
    inwards = np.zeros_like(skin)
    inwards[:, 2] = -1
    if geometry.skin == "dome":
        inwards = -skin / np.linalg.norm(skin, axis=1, keepdims=True)
    return Taxels(grid, rays.inside, cell, below, skin + below[:, None, None] * inwards)
