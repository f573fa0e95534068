"""A sensor seen at half the resolution: a quarter of the pixels for everything up to the network."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from tacshade_edge.core.geometry.disc import Grid, Window, disc_mask
from tacshade_edge.core.image.binarise import Binariser, halved
from tacshade_edge.types import U8, Calibration, Disc

MOVED_PARTS = (1 / 8, 3 / 4, 1 / 8)
"""Of the reference moved by a pixel back, not at all and on, along each axis. With more of it moved depth is found less
exactly where nothing moved."""

LEAST_PITCH_PX = 14.0
"""A finer pattern is left as it is: of less than 7 px a pitch the networks have seen little."""


def can_be_halved(calibration: Calibration) -> bool:
    """Whether enough is left of the sensor's pattern."""
    side_px = min(calibration.image_height_px, calibration.image_width_px)
    return calibration.pitch_px >= LEAST_PITCH_PX and side_px > 1


def halved_image(grey: U8) -> U8:
    """Means over 2x2 px, rounded half up; of an odd side the last row or column is left out."""
    return halved(grey[: grey.shape[0] // 2 * 2, : grey.shape[1] // 2 * 2])


def grid_of_whole(grid: Grid) -> Grid:
    """Where the cells of a grid on the halved image lie in the whole one."""
    return Grid(grid.rows, grid.cols, 2 * grid.row0 + 0.5, 2 * grid.col0 + 0.5, 2 * grid.step_px)


def halved_calibration(calibration: Calibration) -> Calibration:
    """What calibrating on halved images would have found: the same skin, camera and light in pixels twice as wide.

    Of its white a part is of the image moved by a pixel (`MOVED_PARTS`): that pairs the pixels another way, and a
    camera that moved by one would else look like less depth.
    """
    geometry = calibration.geometry
    at = geometry.disc
    # Pixels (2i, 2i+1) have their middle at 2i + 0.5.
    disc = Disc((at.row_c - 0.5) / 2, (at.col_c - 0.5) / 2, at.radius_px / 2)
    grey = halved_image(calibration.reference_grey)
    height, width = grey.shape
    pitch_px = calibration.pitch_px / 2
    # As frames are binarised: inside the disc's window, whose first pixel the blocks of the threshold start from.
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
