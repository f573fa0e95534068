"""Height maps as a stitched map has them."""

from __future__ import annotations

import numpy as np

from tacshade_edge.stitching.stitcher import Raster


def raster(rows: int = 30, cols: int = 40, height_mm: float = 2.0) -> Raster:
    """Heights that grow downwards, with a hole at (6, 6);
    0.25 mm a cell, from x 10 and y -20 mm.
    """
    z = np.linspace(-1, -1 + height_mm, rows * cols, dtype=np.float32).reshape(rows, cols)
    z[5:8, 5:8] = np.nan
    return Raster(z, 10.0, -20.0, 0.25)
