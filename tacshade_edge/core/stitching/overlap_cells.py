"""Sort the points of overlapping presses into square cells of the plane, and measure the surface's slope in each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tacshade_edge.types import F64, I64

_SLOPE_MAX = 2.0  # mm per mm; a steeper slope between two cells is a step


@dataclass(frozen=True, slots=True, eq=False)
class OverlapCells:
    """The cells of a set of points: the cell of each, from 0; the number of cells with a point; the slope (N, 2) along
    x and y of the points' mean surface in each point's cell; z that each point gives to the middle of its cell, with
    the slope removed.
    """

    of_point: I64
    count: int
    slope: F64
    height_mm: F64

    def means(self, values: F64, weight: F64) -> F64:
        """The weighted mean of the points' values in each cell, (count,)."""
        return _means(values, weight, self.of_point, self.count)


def overlap_cells(at: F64, weight: F64, cell_mm: float) -> OverlapCells:
    """Sort points (N, 3) in the base frame, with weights (N,), into cells."""
    column_row = np.floor(at[:, :2] / cell_mm).astype(np.int64)
    offset = at[:, :2] - (column_row + 0.5) * cell_mm
    column_row -= column_row.min(axis=0)
    width = int(column_row[:, 0].max()) + 3  # a free column between rows, so that neighbours need no checks
    key = (column_row[:, 1] + 1) * width + column_row[:, 0] + 1
    used, cell = np.unique(key, return_inverse=True)
    z = _means(at[:, 2], weight, cell, len(used))
    slope = np.stack([_slope(used, z, step, cell_mm) for step in (1, width)], axis=1)[cell]
    return OverlapCells(cell, len(used), slope, at[:, 2] - np.sum(slope * offset, axis=1))


def _slope(used: I64, z: F64, step: int, cell_mm: float) -> F64:
    """Slope of the cells' heights towards the neighbour at `step`, from both sides, one or none; mm per mm."""

    def neighbour(by: int) -> F64:
        at = np.minimum(np.searchsorted(used, used + by), len(used) - 1)
        return np.where(used[at] == used + by, z[at], np.nan)

    sides = np.stack((neighbour(step) - z, z - neighbour(-step))) / cell_mm
    known = np.isfinite(sides)
    mean = np.where(known, sides, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.asarray(np.clip(mean, -_SLOPE_MAX, _SLOPE_MAX))


def _means(values: F64, weight: F64, cell: I64, cells: int) -> F64:
    return np.asarray(np.bincount(cell, weight * values, cells) / np.bincount(cell, weight, cells))
