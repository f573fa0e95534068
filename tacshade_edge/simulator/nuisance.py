"""Disturb a sensor's images as in use: functions from image to image, uint8 (H, W) or (H, W, 3)."""

from __future__ import annotations

import numpy as np

from tacshade_edge.types import U8


def gain(image: U8, factor: float) -> U8:
    """Multiply the light by a factor (0.9: 10 % dimmer); clips at 255."""
    return np.asarray(np.clip(image.astype(np.float32) * factor + 0.5, 0, 255), np.uint8)


def shift(image: U8, rows: int, cols: int) -> U8:
    """Move the image by whole pixels, repeating its border."""
    height, width = image.shape[:2]
    i = np.clip(np.arange(height) - rows, 0, height - 1)
    j = np.clip(np.arange(width) - cols, 0, width - 1)
    return np.asarray(image[i][:, j], np.uint8)
