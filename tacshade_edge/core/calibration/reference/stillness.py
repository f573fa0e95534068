"""Does a picture stand still? What a moving skin changes that the camera's noise does not."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from tacshade_edge.types import F32, U8

# Means over blocks of so many pixels: noise falls to an eighth, a shift of the pattern hardly.
BLOCK_PX = 8
# Above what the resting skin shows by this factor and so many grey levels, something moves: 0.05 mm of a ball's travel
# makes 5 to 18 levels where rest makes 2.2 to 3.4 (five simulated sensors, 640x480, 20 frames).
_REST_FACTOR, _REST_GREY = 1.3, 0.5
REST_MOST_GREY = 8.0
"""More than the noise of a usable camera makes at rest."""


def block_means(grey: U8) -> F32:
    """Means of a grey image's blocks.

    Parameters
    ----------
    grey : uint8 (H, W)
        At least 8 x 8.

    Returns
    -------
    float32 (H // 8, W // 8)
        Grey levels.
    """
    rows, cols = grey.shape[0] // BLOCK_PX, grey.shape[1] // BLOCK_PX
    whole = grey[: rows * BLOCK_PX, : cols * BLOCK_PX].astype(np.float32)
    return np.asarray(cv2.resize(whole, (cols, rows), interpolation=cv2.INTER_AREA), np.float32)


def motion_grey(blocks: Sequence[F32]) -> float:
    """How much the most moved block changed over a time, beyond what all changed by.

    Parameters
    ----------
    blocks : sequence of float32 (h, w)
        `block_means` of one image or more, in any order.

    Returns
    -------
    float
        Grey levels from the least to the greatest mean of that block; 0 of one image.
    """
    change = np.stack(blocks) - blocks[0]
    change -= np.median(change, axis=(1, 2), keepdims=True)  # a light that flickers moves nothing
    return float((change.max(axis=0) - change.min(axis=0)).max())


def stands_still(motion: float, rest: float) -> bool:
    """Whether a `motion_grey` is that of a held picture, by the one of the untouched skin over as many images."""
    return motion <= _REST_FACTOR * rest + _REST_GREY
