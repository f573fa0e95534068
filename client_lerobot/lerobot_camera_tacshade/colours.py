"""Converts height and shear to a picture for an image encoder, and back. Pure."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]
U8 = npt.NDArray[np.uint8]

STEP_MM: Final = 0.025
"""Length per grey level in mm, in all channels."""
_HEIGHT_ZERO, _SHEAR_ZERO = 1, 128


def to_rgb(height_mm: F32, shear_mm: F32 | None) -> U8:
    """The RGB picture, uint8 (rows, cols, 3), of a height map (rows, cols) and its shear (rows,
    cols, 2) in mm.

    Red is 1 + h / `STEP_MM`, green and blue 128 + shear / `STEP_MM` along x and y, rounded and
    clipped to 1 to 255 (h to 6.35 mm, shear to ±3.175 mm, 0 without one); all are 0 outside the
    visible circle, where the height is NaN.
    """
    picture = np.full((*height_mm.shape, 3), float(_SHEAR_ZERO), np.float32)
    picture[..., 0] = _HEIGHT_ZERO + height_mm / STEP_MM
    if shear_mm is not None:
        picture[..., 1:] += np.nan_to_num(shear_mm, nan=0.0, posinf=None, neginf=None) / STEP_MM
    np.clip(np.rint(picture, out=picture), 1, 255, out=picture)
    picture[np.isnan(height_mm)] = 0
    return picture.astype(np.uint8)


def to_mm(picture: U8) -> tuple[F32, F32]:
    """The height and the shear in mm in a picture of `to_rgb`, shaped as there;
    NaN outside the circle.

    Within the ranges of `to_rgb` they are accurate to half of `STEP_MM`.
    """
    outside = (picture == 0).any(axis=-1)
    zero = np.array((_HEIGHT_ZERO, _SHEAR_ZERO, _SHEAR_ZERO), np.float32)
    values = (picture.astype(np.float32) - zero) * np.float32(STEP_MM)
    values[outside] = np.nan
    return values[..., 0], values[..., 1:]
