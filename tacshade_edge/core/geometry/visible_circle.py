"""Measure how much of the visible circle's rim is in an image."""

from __future__ import annotations

import numpy as np

from tacshade_edge.types import Disc

LEAST_RIM_SEEN = 0.25
"""Least part of the rim in the image; with less, the pattern ends at the image's own border."""

_RAYS = 1440


def rim_seen(shape: tuple[int, ...], disc: Disc) -> float:
    """Part of a circle's rim, 0 to 1, that lies in an image of a shape (rows, cols)."""
    angles = 2 * np.pi * np.arange(_RAYS) / _RAYS
    rows, cols = disc.row_c + disc.radius_px * np.sin(angles), disc.col_c + disc.radius_px * np.cos(angles)
    return float(np.mean((rows >= 0) & (rows <= shape[0] - 1) & (cols >= 0) & (cols <= shape[1] - 1)))
