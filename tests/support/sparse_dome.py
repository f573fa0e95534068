"""A drawn dome as a TacTip's camera sees it: white pins in its middle, dark around them, a ring of lamps."""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.types import F64, U8, Disc

SIZE = (480, 640)
DOME = Disc(252.0, 312.0, 205.0)
RINGS = 6
"""Of the hexagon of pins around its middle one: 127 pins."""
PITCH_PX = 23.0
FIELD = Disc(DOME.row_c, DOME.col_c, (RINGS + 0.5) * PITCH_PX)
"""The circle around the pins."""
DARK, LAMPS = 20, 225


def pins_px(pitch_px: float = PITCH_PX) -> F64:
    """Row and column of each pin."""
    steps = range(-RINGS, RINGS + 1)
    return np.array(
        [
            (DOME.row_c + b * pitch_px * 3**0.5 / 2, DOME.col_c + (a + b / 2) * pitch_px)
            for b in steps
            for a in steps
            if abs(a + b) <= RINGS
        ]
    )


def sparse_dome(
    seed: int = 0,
    noise_grey: float = 2.5,
    exposure_grey: float = 0.0,
    pressed: bool = False,
    contrast_grey: float = 120.0,
) -> U8:
    """Draw it; `pressed` spreads the pins of the middle, `exposure_grey` lifts all that is dark."""
    image = np.full(SIZE, DARK + exposure_grey, np.float32)
    at = np.hypot(*np.meshgrid(np.arange(SIZE[0]) - DOME.row_c, np.arange(SIZE[1]) - DOME.col_c, indexing="ij"))
    image[at > DOME.radius_px] = LAMPS
    image[at > 1.35 * DOME.radius_px] = 70
    light = np.maximum(1 - 0.5 * (at / DOME.radius_px) ** 2, 0.3)
    pins = np.zeros(SIZE, np.float32)
    for row, col in pins_px():
        off = np.array((row - DOME.row_c, col - DOME.col_c))
        far = float(np.linalg.norm(off))
        if pressed and far < 110:
            row, col = (DOME.row_c, DOME.col_c) + off * (1 + 0.35 * (1 - far / 110))
        cv2.circle(pins, (round(16 * col), round(16 * row)), round(16 * 4.5), 1.0, -1, cv2.LINE_AA, 4)
    image += cv2.GaussianBlur(pins, (0, 0), 1.2) * contrast_grey * light
    image += np.random.default_rng(seed).normal(0, noise_grey, SIZE)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
