"""Sensors that are built without presses: from numbers, and as pictures of sparse domes."""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.sensor.geometry.disc import Window, disc_mask
from tacshade_edge.sensor.image.white import binarise
from tacshade_edge.types import F64, U8, Binarisation, Calibration, Disc, Geometry, Polarity

DARK, BRIGHT = 30, 200
SPARSE = StatedSensor(20.0, 25.0, 50.0, "dark")
"""What one may state of `sparse_dome`."""
SPREAD = 1.16


def marked(
    height_px: int, width_px: int, pitch_px: float, disc: Disc, *, pressed_px: float = 0.0
) -> U8:
    """Bright round markers on dark ground, with soft edges;
    larger and spread within `pressed_px` of its middle.
    """
    rows, cols = np.ogrid[:height_px, :width_px]
    pressed = np.hypot(rows - disc.row_c, cols - disc.col_c) < pressed_px
    spread = np.where(pressed, 1 / SPREAD, 1.0)
    cell_rows, cell_cols = (
        np.mod(middle + (at - middle) * spread, pitch_px) - pitch_px / 2
        for at, middle in ((rows, disc.row_c), (cols, disc.col_c))
    )
    from_marker = np.hypot(cell_rows, cell_cols) / pitch_px
    cover = np.clip(
        (np.where(pressed, 0.42, 0.28) - from_marker) * max(pitch_px / 2, 2) + 0.5, 0, 1
    )
    return np.asarray(np.rint(DARK + (BRIGHT - DARK) * cover), np.uint8)


def built_calibration(
    height_px: int,
    width_px: int,
    *,
    disc: Disc | None = None,
    pitch_px: float | None = None,
    reference: U8 | None = None,
    camera_distance_mm: float | None = 30.0,
    polarity: Polarity = "bright",
    binarisation: Binarisation = "adaptive",
    alpha: float = 15.0,
    noise_grey: float = 0.5,
) -> Calibration:
    """As `calibrate` would make it of `reference` (`marked` where not given);
    the disc fills the image's short side.
    """
    disc = disc or Disc((height_px - 1) / 2, (width_px - 1) / 2, 0.45 * min(height_px, width_px))
    pitch_px = pitch_px or max(disc.radius_px / 10, 2.0)
    grey = marked(height_px, width_px, pitch_px, disc) if reference is None else reference
    window = Window.of_disc(height_px, width_px, disc)
    mask = window.cut(disc_mask(height_px, width_px, disc).astype(np.uint8))
    white = np.zeros_like(grey)
    window.cut(white)[...] = 255 * binarise(window.cut(grey), mask, binarisation, pitch_px)
    return Calibration(
        geometry=Geometry(20.0, camera_distance_mm, 50.0, disc),
        polarity=polarity,
        binarisation=binarisation,
        image_height_px=height_px,
        image_width_px=width_px,
        pitch_px=pitch_px,
        reference_white=white,
        reference_grey=grey,
        noise_grey=noise_grey,
        alpha=alpha,
    )


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
    at = np.hypot(
        *np.meshgrid(
            np.arange(SIZE[0]) - DOME.row_c, np.arange(SIZE[1]) - DOME.col_c, indexing="ij"
        )
    )
    image[at > DOME.radius_px] = LAMPS
    image[at > 1.35 * DOME.radius_px] = 70
    light = np.maximum(1 - 0.5 * (at / DOME.radius_px) ** 2, 0.3)
    pins = np.zeros(SIZE, np.float32)
    for row, col in pins_px():
        off = np.array((row - DOME.row_c, col - DOME.col_c))
        far = float(np.linalg.norm(off))
        if pressed and far < 110:
            row, col = (DOME.row_c, DOME.col_c) + off * (1 + 0.35 * (1 - far / 110))
        cv2.circle(
            pins, (round(16 * col), round(16 * row)), round(16 * 4.5), 1.0, -1, cv2.LINE_AA, 4
        )
    image += cv2.GaussianBlur(pins, (0, 0), 1.2) * contrast_grey * light
    image += np.random.default_rng(seed).normal(0, noise_grey, SIZE)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def from_one_image(image: U8, sensor: StatedSensor = SPARSE) -> Calibration:
    """Calibrate with one reference, in which anything may be pressed."""
    return calibrate(sensor, [image], allow_loaded_reference=True).calibration
