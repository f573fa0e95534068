"""Does anything move in successive images of a skin?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tacshade_edge.sensor.image.white import squares
from tacshade_edge.types import F32, U8

# Side of a block: its mean reduces noise to an eighth, but hardly reduces a shift of the pattern.
BLOCK_PX = 8
# Something moves if the change exceeds that of the resting skin by this factor and these grey
# levels: 0.05 mm of a ball's travel causes 5 to 18 levels, rest 2.2 to 3.4 (five simulated sensors,
# 640x480, 20 frames).
_REST_FACTOR, _REST_GREY = 1.3, 0.5
REST_MOST_GREY = 8.0
"""Grey levels above the `motion_grey` of any usable camera at rest."""


def block_means(grey: U8) -> F32:
    """Means over blocks of a grey image of at least 8 x 8: (H // 8, W // 8)."""
    return squares(grey, BLOCK_PX)[0]


def motion_grey(blocks: Sequence[F32]) -> float:
    """Change over time of the block that changed most, less the change shared by all,
    over `block_means` of images.
    """
    change = np.stack(blocks) - blocks[0]
    change -= np.median(change, axis=(1, 2), keepdims=True)  # a flickering light is not motion
    # Greatest less least rather than a deviation: one jerk of a hand must count in full.
    return float((change.max(axis=0) - change.min(axis=0)).max())


def stands_still(motion: float, rest: float) -> bool:
    """Whether a `motion_grey` is that of a still image,
    given that of the untouched skin over as many images.
    """
    return motion <= _REST_FACTOR * rest + _REST_GREY
