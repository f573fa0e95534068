"""A smooth pattern of pins on the cells of a map, moved as one piece."""

from __future__ import annotations

import numpy as np

from tacshade_edge.sensor.geometry.disc_map import REACH
from tacshade_edge.types import F32, Bool

N = 112
AXIS = (np.arange(N) + 0.5 - N / 2) * (2 * REACH / N)
X, Y = np.meshgrid(AXIS, AXIS)


def disc() -> Bool:
    return np.asarray(X * X + Y * Y < 1)


def pattern(
    shift_x: float = 0.0, shift_y: float = 0.0, turn: float = 0.0, gain: float = 1.0
) -> F32:
    """Smooth pins at a pitch of a sixth of the radius, moved by radii and radians."""
    x, y = X - shift_x, Y - shift_y
    x, y = x + turn * y, y - turn * x
    white = 0.5 + 0.4 * np.cos(2 * np.pi * x * 6) * np.cos(2 * np.pi * y * 6)
    return np.asarray(gain * white, np.float32)
