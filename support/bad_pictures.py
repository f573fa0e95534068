"""What studies and tests do to pictures beside `lab.simulator.camera_faults`,
which a sensor in training meets.
"""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.types import U8


def warm(image: U8, row_c: float, col_c: float, part: float) -> U8:
    """Warm up camera and LEDs, fully at `part` 1: 8 % less light, black 6 levels higher,
    an image 0.3 % larger.
    """
    zoom = 1 + 0.003 * part
    to_cold = np.array(
        ((1 / zoom, 0, col_c * (1 - 1 / zoom)), (0, 1 / zoom, row_c * (1 - 1 / zoom)))
    )
    size = (image.shape[1], image.shape[0])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    larger = cv2.warpAffine(image, to_cold, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(
        np.clip(larger.astype(np.float32) * (1 - 0.08 * part) + 6 * part + 0.5, 0, 255), np.uint8
    )


def torn(image: U8, other: U8, row: int, shift_px: int = 0) -> U8:
    """Show `other` from `row` on, shifted sideways by `shift_px`,
    like two frames in one or a lost line sync.
    """
    result = image.copy()
    result[row:] = np.roll(other[row:], shift_px, axis=1)
    return result


def defocus(image: U8, sigma_px: float) -> U8:
    """Blur by a Gaussian of the given standard deviation."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.uint8)
