"""The cheapest thing that is right: the calibrated table, or α · g_hn where nothing is calibrated."""

from __future__ import annotations

import numpy as np

from tacshade_edge.core.greyscale import shape_grey
from tacshade_edge.core.solvers.base import Depth, DepthScale, GreyMaps
from tacshade_edge.types import F32


def solve(maps: GreyMaps, scale: DepthScale) -> Depth:
    """Height from the table at g_d (clamped at its ends), or α · g_hn."""
    finite = np.isfinite(maps.g_d)
    repaired = int(finite.size - np.count_nonzero(finite))
    g_d = maps.g_d if repaired == 0 else np.where(finite, maps.g_d, np.float32(0))
    if scale.table_grey.size == 0:
        height: F32 = np.float32(scale.alpha_mm) * shape_grey(g_d, maps.g0, maps.inside)
        return Depth(height_mm=height, saturated=False, repaired_px=repaired)
    values = np.interp(g_d, scale.table_grey, scale.table_depth_mm, left=0.0).astype(np.float32)
    height = np.where(maps.inside, values, np.float32(0))
    saturated = bool((g_d[maps.inside] > scale.table_grey[-1]).any())
    return Depth(height_mm=height, saturated=saturated, repaired_px=repaired)
