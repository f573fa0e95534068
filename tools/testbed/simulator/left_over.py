"""The dent that a skin keeps after a release."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tacshade_edge.simulator.skin import Skin


def left_over(skin: Skin, part: float) -> Skin:
    """Make the shape that a creeping skin keeps for a while after a release: a weaker dent without the object."""
    weaker = np.float32(part)
    return replace(
        skin,
        height_mm=skin.height_mm * weaker,
        obstacle_mm=np.zeros_like(skin.obstacle_mm),
        leaning_mm=None if skin.leaning_mm is None else skin.leaning_mm * weaker,
        origin_mm=None if skin.origin_mm is None else skin.origin_mm * weaker,
        stuck=(),
        slid_mm=(),
    )
