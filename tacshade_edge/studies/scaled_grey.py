"""The paper's depth without eq. 11, the starting point of its iterations, to show how much they improve."""

from __future__ import annotations

import numpy as np

from tacshade_edge.core.depth import Depth
from tacshade_edge.core.depth.hybrid_sfs import finite_shape_grey, scaled
from tacshade_edge.core.image.grey_maps import GreyMaps


def scaled_grey(maps: GreyMaps, alpha_mm: float) -> Depth:
    """The depth α g_hn, in place of `hybrid_sfs.hybrid_depth`."""
    g_hn, bad = finite_shape_grey(maps)
    return scaled(g_hn.astype(np.float64), alpha_mm, bad)
