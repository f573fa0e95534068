"""The paper's fusion (section V-B): pools all points and averages heights within a radius, by a KD-tree."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tacshade_edge.core.stitching.surface_map import Raster, SurfaceMap
from tacshade_edge.types import F64

_BLOCK_MM = 100.0
RADIUS_MM = 1.0
"""Radius of the average; the paper only states "a designated range"."""


def radius_average(points_mm: F64, step_mm: float, radius_mm: float = RADIUS_MM) -> Raster:
    """Average heights within a radius in the x, y plane, then in cells.

    Parameters
    ----------
    points_mm : float64 (N, 3)
        Points of all presses, in the base frame, with equal weights.
    step_mm : float
        Step of the raster.
    """
    pairs = cKDTree(points_mm[:, :2]).query_pairs(radius_mm, output_type="ndarray")
    count = np.bincount(pairs.ravel(), minlength=len(points_mm)) + 1
    total = points_mm[:, 2].copy()
    for one, other in ((0, 1), (1, 0)):
        total += np.bincount(pairs[:, one], points_mm[pairs[:, other], 2], len(points_mm))
    fused = SurfaceMap(step_mm, bounded=False)
    averaged = np.column_stack((points_mm[:, :2], total / count))
    # The map accepts the extent of one press at a time, not a table's width.
    _, block = np.unique(np.floor(points_mm[:, :2] / _BLOCK_MM), axis=0, return_inverse=True)
    for k in range(block.max() + 1):
        part = averaged[block == k]
        fused.add(part, np.ones(len(part)))
    return fused.raster()
