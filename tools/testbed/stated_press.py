"""A known press as a user states it: slightly off in place and depth."""

from __future__ import annotations

import numpy as np

from tacshade_edge.core.calibration.indenters import Indenter
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.simulator.press import Press
from tacshade_edge.types import U8

PLACE_NOISE_MM, DEPTH_NOISE_MM = 0.05, 0.03
"""Standard deviations of a stated place, along x and y, and of a stated depth."""


def stated_press(
    rng: np.random.Generator, name: str, image: U8, press: Press, radius_mm: float, known: Indenter | None
) -> KnownPress:
    """State a press of a ball of `radius_mm`, or of another indenter that is `known`."""
    x_mm, y_mm = (at + rng.normal(0, PLACE_NOISE_MM) for at in (press.x_mm, press.y_mm))
    depth_mm = press.depth_mm + rng.normal(0, DEPTH_NOISE_MM)
    return KnownPress(name, image, radius_mm, depth_mm, x_mm, y_mm, known, press.rotation_deg if known else 0.0)
