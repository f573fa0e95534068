"""Halve a sensor's resolution: a quarter of the pixels for all steps before the network."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from tacshade_edge.core.geometry.disc import Grid, Window, disc_mask
from tacshade_edge.core.image.binarise import Binariser, halved
from tacshade_edge.core.profiles import Profile
from tacshade_edge.types import U8, Calibration, Disc

MOVED_PARTS = (1 / 8, 3 / 4, 1 / 8)
"""Weights of the reference shifted by a pixel back, not at all and forward, along each axis. More weight on the shifted
ones makes the depth less exact if nothing shifted."""

LEAST_PITCH_PX = 14.0
"""Finer patterns are not halved: the networks have seen few pitches below 7 px."""


def is_halved(calibration: Calibration, profile: Profile) -> bool:
    """Whether a profile works on halved images of a sensor: its pattern must stay coarse enough.

    A network also sees a noisy camera halved: one that needs Otsu's level (`reference.threshold_choice`). Its pixels
    differ from their neighbours, which a mean over 2x2 px evens out, but a network of whole images takes for torn skin.
    """
    side_px = min(calibration.image_height_px, calibration.image_width_px)
    wanted = profile.halved or (profile.network is not None and calibration.binarisation == "otsu")
    return wanted and calibration.pitch_px >= LEAST_PITCH_PX and side_px > 1


def halved_image(grey: U8) -> U8:
    """Means over 2x2 px, rounded half up, without the last row or column of an odd side."""
    return halved(grey[: grey.shape[0] // 2 * 2, : grey.shape[1] // 2 * 2])


def grid_of_whole(grid: Grid) -> Grid:
    """Convert a grid on the halved image to one on the whole image."""
    return Grid(grid.rows, grid.cols, 2 * grid.row0 + 0.5, 2 * grid.col0 + 0.5, 2 * grid.step_px)


def halved_calibration(calibration: Calibration) -> Calibration:
    """The calibration that halved images would give: the same skin, camera and light in pixels twice as wide.

    Part of its white comes from the image shifted by a pixel (`MOVED_PARTS`), which pairs the pixels differently;
    without it, a camera shifted by a pixel would look like less depth.
    """
    geometry = calibration.geometry
    at = geometry.disc
    # The middle of pixels (2i, 2i+1) is at 2i + 0.5.
    disc = Disc((at.row_c - 0.5) / 2, (at.col_c - 0.5) / 2, at.radius_px / 2)
    grey = halved_image(calibration.reference_grey)
    height, width = grey.shape
    pitch_px = calibration.pitch_px / 2
    # Binarise inside the disc's window, as for frames, because the threshold's blocks start at its first pixel.
    window = Window.of_disc(height, width, disc)
    mask = window.cut(disc_mask(height, width, disc).astype(np.uint8))
    binariser = Binariser(mask, calibration.binarisation, pitch_px)
    white = np.zeros(grey.shape, np.float32)
    around = np.pad(calibration.reference_grey, 1, mode="edge")
    for (row, down), (col, across) in product(enumerate(MOVED_PARTS), repeat=2):
        moved = around[row : row + calibration.image_height_px, col : col + calibration.image_width_px]
        window.cut(white)[...] += down * across * binariser(window.cut(halved_image(moved)))
    return replace(
        calibration,
        geometry=replace(geometry, disc=disc),
        image_height_px=height,
        image_width_px=width,
        pitch_px=pitch_px,
        reference_grey=grey,
        reference_white=np.rint(white * np.float32(255)).astype(np.uint8),
        alpha=calibration.alpha / 2,
    )
