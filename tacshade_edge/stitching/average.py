"""The paper's way to fuse presses (section V-B):
each point's z becomes the mean of all points near it in x and y.
"""

from __future__ import annotations

import numpy as np

from tacshade_edge.stitching.stitcher import STEP_MM, Raster, SurfaceMap
from tacshade_edge.types import F64

RADIUS_MM = 1.0
"""Radius of the average; the paper only states "a designated range"."""
_CHUNK = 4096
"""Points whose neighbours are found at once: some ten megabytes of pairs,
however large the map is.
"""
_BLOCK_MM = 100.0


def radius_average(
    points_mm: F64, step_mm: float = STEP_MM, radius_mm: float = RADIUS_MM
) -> Raster:
    """Average the heights of points within a radius in the x, y plane,
    then in the cells of a raster.

    Parameters
    ----------
    points_mm
        The points of all presses in the base frame, which count alike:
        float64 (N, 3), finite, N > 0.
    step_mm
        The raster's step, above 0.
    radius_mm
        The "designated range" of section V-B, above 0.

    Returns
    -------
    Raster
        The averaged surface; a cell without a point is NaN.

    Raises
    ------
    ValueError
        If a point is farther from the base than a map allows.
    """
    fused = SurfaceMap(step_mm, bounded=False)
    averaged = np.column_stack((points_mm[:, :2], mean_heights(points_mm, radius_mm)))
    # The map accepts the extent of one press at a time, not a table's width.
    _, block = np.unique(np.floor(points_mm[:, :2] / _BLOCK_MM), axis=0, return_inverse=True)
    for k in range(block.max() + 1):
        part = averaged[block == k]
        fused.add(part, np.ones(len(part)))
    return fused.raster()


def mean_heights(points_mm: F64, radius_mm: float) -> F64:
    """The mean z (N,) of the points within the radius of each point, itself included."""
    from scipy.spatial import cKDTree  # a daemon does not need it

    tree, means = cKDTree(points_mm[:, :2]), np.empty(len(points_mm))
    for first in range(0, len(points_mm), _CHUNK):
        chunk = points_mm[first : first + _CHUNK, :2]
        near = cKDTree(chunk).sparse_distance_matrix(tree, radius_mm, output_type="ndarray")
        count = np.bincount(near["i"], minlength=len(chunk))
        total = np.bincount(near["i"], points_mm[near["j"], 2], len(chunk))
        means[first : first + _CHUNK] = total / count
    return means
