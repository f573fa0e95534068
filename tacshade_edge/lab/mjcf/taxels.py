"""Where MuJoCo's tactile sensor samples what touches the skin, and what its depths mean. Pure.

MuJoCo gives the distance of each taxel to the nearest surface of the object that it lies in. The
skin's mechanics need how far the object reaches in along a cell's own direction: beside a wall,
that is much more. So each cell has a column of taxels, the first of them outside the skin; between
the last one inside the object and the next, the depth runs out, and the object ends.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from tacshade_edge.sensor.geometry.disc import Grid, disc_rays, radius_squared, skin_points
from tacshade_edge.sensor.geometry.disc_map import map_grid
from tacshade_edge.types import F32, F64, I64, Bool, Geometry, frozen

CELLS: Final = 56
"""Cells along a side of the disc map, as in the profile `fast`."""
SHELLS: Final = 9
GAP_PER_SIZE: Final = 1 / 20
"""Distance between shells of taxels, in sizes of the skin: 1 mm on a dome of 20 mm. The shells
reach from one such step outside the skin to seven inside.
"""
# Of the depth along a column, per step. Beside a wall, the depth hardly falls, or has only just
# begun to: it said how far the wall is, and is only the least that may lie before the object's end.
_LEAST_SLOPE = 0.3


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


def reached_mm(taxels: Taxels, depth_mm: F64) -> tuple[F32, F32]:
    """The least and the greatest that objects may reach into the undeformed skin at each cell,
    float32 (rows, cols), from the taxels' depths (shells, N); 0 where none does. They differ only
    beside walls.
    """
    shells = len(depth_mm)
    gap = float(taxels.below_mm[1] - taxels.below_mm[0])
    least, greatest = np.zeros((2, taxels.grid.rows * taxels.grid.cols), np.float32)
    # What only the shell outside feels does not touch the undeformed skin.
    felt = np.flatnonzero((depth_mm[1:] > 0).any(axis=0))
    last = shells - 1 - np.argmax(depth_mm[::-1, felt] > 0, axis=0)
    here, before, earlier = (depth_mm[np.maximum(last - back, 0), felt] for back in range(3))
    # Newton's parabola through the last three depths, and the step from the last at which it is 0.
    bend = np.where(last > 1, here - 2 * before + earlier, 0.0)
    fall = before - here - bend / 2
    root = np.sqrt(np.maximum(fall * fall - 2 * bend * here, 0))
    least_fall = _LEAST_SLOPE * gap
    wall = (fall < least_fall) | ((last > 1) & (earlier - before < least_fall))
    wall &= last < shells - 1
    steps = np.where(wall, here / gap, 2 * here / np.maximum(fall + root, least_fall))
    # Depth is a distance, and falls by a step per step at most. The next taxel is outside the
    # object, but the last shell has none.
    steps = np.maximum(steps, here / gap)
    steps = np.minimum(steps, np.where(last < shells - 1, 1.0, np.inf))
    least[taxels.cell[felt]] = taxels.below_mm[last] + gap * steps
    greatest[taxels.cell[felt]] = taxels.below_mm[last] + gap * np.where(wall, 1.0, steps)
    shape = taxels.grid.rows, taxels.grid.cols
    return least.reshape(shape), greatest.reshape(shape)
