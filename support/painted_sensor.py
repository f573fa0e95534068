"""A small painted sensor that takes a millisecond per image,
for tests of the code around the core.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.calibration.files.calibration_file import with_crc
from tacshade_edge.sensor.image.white import binarise
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import DEFAULT, PROFILES
from tacshade_edge.types import U8, Calibration, Disc, Fit, Frame, Geometry, ProfileFit

HEIGHT, WIDTH, PITCH_PX = 120, 160, 8.0
SCALE = 4  # of `enlarged`
PRESSED_PX, SPREAD = 20.0, 0.16
DISC = Disc(59.5, 79.5, 52.0)
FREE_FRAMES, TOUCHED_FRAMES = 32, 32
"""At 60 frames a second, a contact comes to rest (0.3 s),
and a reference fits between two contacts.
"""


def painted(*, touched: bool = False) -> U8:
    """White markers on a dark disc; larger markers in the middle, spread from there,
    where touched.
    """
    image = np.full((HEIGHT, WIDTH), 30, dtype=np.uint8)
    for i, row in enumerate(np.arange(4, HEIGHT, PITCH_PX)):
        for col in np.arange(4 + (i % 2) * PITCH_PX / 2, WIDTH, PITCH_PX):
            far_px = np.hypot(row - DISC.row_c, col - DISC.col_c)
            spread = SPREAD if touched and far_px < PRESSED_PX else 0.0
            at = (
                round(col + spread * (col - DISC.col_c)),
                round(row + spread * (row - DISC.row_c)),
            )
            cv2.circle(image, at, 3 if spread else 2, 200, -1)
    return image


def painted_calibration() -> Calibration:
    grey = painted()
    rows, cols = np.ogrid[:HEIGHT, :WIDTH]
    mask = (np.hypot(rows - DISC.row_c, cols - DISC.col_c) <= DISC.radius_px).astype(np.uint8)
    return with_crc(
        Calibration(
            geometry=Geometry(20.0, 30.0, 50.0, DISC),
            polarity="bright",
            binarisation="adaptive",
            image_height_px=HEIGHT,
            image_width_px=WIDTH,
            pitch_px=PITCH_PX,
            reference_white=255 * binarise(grey, mask, "adaptive", PITCH_PX),
            reference_grey=grey,
            noise_grey=0.5,
            alpha=15.0,
            factors={"accurate": 1.0},
            fit=Fit(20, 0.1, 0.5, {"accurate": ProfileFit(20, 0.2, 0.6)}),
        )
    )


FREE, TOUCHED, BLACK = painted(), painted(touched=True), np.zeros((HEIGHT, WIDTH), dtype=np.uint8)


def touched_depth_mm() -> float:
    """The core's depth in mm for `TOUCHED` with the default profile:
    a subscriber must find the same.
    """
    result = make_reconstructor(painted_calibration(), PROFILES[DEFAULT]).step(
        Frame(0, 0, 0, TOUCHED)
    )
    assert result.contact
    return float(np.nanmax(result.height.height_mm))


def enlarged(image: U8) -> U8:
    """To 640x480, as a lens would show it: without its blur,
    rows that follow the painted pattern look torn.
    """
    return np.asarray(
        cv2.GaussianBlur(image.repeat(SCALE, axis=0).repeat(SCALE, axis=1), (0, 0), 1.5), np.uint8
    )


def enlarged_calibration() -> Calibration:
    """A calibration of the enlarged painted sensor."""
    small = painted_calibration()
    disc = small.geometry.disc
    middle = (SCALE - 1) / 2
    large = Disc(disc.row_c * SCALE + middle, disc.col_c * SCALE + middle, disc.radius_px * SCALE)
    return replace(
        small,
        geometry=replace(small.geometry, disc=large),
        image_height_px=small.image_height_px * SCALE,
        image_width_px=small.image_width_px * SCALE,
        pitch_px=small.pitch_px * SCALE,
        reference_white=enlarged(small.reference_white),
        reference_grey=enlarged(small.reference_grey),
    )


def write_posed_images(folder: Path) -> None:
    """Write frames of an untouched and a touched skin, all with the same pose."""
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "free.png"), FREE)
    cv2.imwrite(str(folder / "touched.png"), TOUCHED)
    rows = ["image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz"]
    for k in range(FREE_FRAMES + TOUCHED_FRAMES):
        name = "free.png" if k < FREE_FRAMES else "touched.png"
        rows.append(f"{name},{k * 16_666_667},1.5,-2,60,0,1,0,0")
    (folder / "frames.csv").write_text("\n".join(rows) + "\n")
