"""Calibrations built directly, for sensors that nobody would calibrate: any image size, any disc, any pitch."""

from __future__ import annotations

import numpy as np

from tacshade_edge.core.geometry.disc import Window, disc_mask
from tacshade_edge.core.image.binarise import binarise
from tacshade_edge.types import U8, Binarisation, Calibration, Disc, Geometry, Polarity

DARK, BRIGHT = 30, 200
SPREAD = 1.16


def marked(height_px: int, width_px: int, pitch_px: float, disc: Disc, *, pressed_px: float = 0.0) -> U8:
    """Bright round markers on dark ground, with soft edges; larger and spread within `pressed_px` of its middle."""
    rows, cols = np.ogrid[:height_px, :width_px]
    pressed = np.hypot(rows - disc.row_c, cols - disc.col_c) < pressed_px
    spread = np.where(pressed, 1 / SPREAD, 1.0)
    cell_rows, cell_cols = (
        np.mod(middle + (at - middle) * spread, pitch_px) - pitch_px / 2
        for at, middle in ((rows, disc.row_c), (cols, disc.col_c))
    )
    from_marker = np.hypot(cell_rows, cell_cols) / pitch_px
    cover = np.clip((np.where(pressed, 0.42, 0.28) - from_marker) * max(pitch_px / 2, 2) + 0.5, 0, 1)
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
    """As `calibrate` would make it of `reference` (`marked` where not given); the disc fills the image's short side."""
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
