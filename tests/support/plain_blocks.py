"""Blocks of 8x8 px in float64, for the checks that `core.frame_check.blocks` makes of rounded ones."""

from __future__ import annotations

import numpy as np

from tacshade_edge.types import F64, U8


def plain_blocks(grey: U8) -> tuple[F64, F64]:
    """Mean and standard deviation of whole blocks."""
    rows, cols = grey.shape[0] // 8, grey.shape[1] // 8
    each = grey[: 8 * rows, : 8 * cols].astype(np.float64).reshape(rows, 8, cols, 8)
    return each.mean(axis=(1, 3)), each.std(axis=(1, 3))
