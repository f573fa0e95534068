"""Faults between a sensor and its image, as functions from image to image, uint8 (H, W) or (H, W,
3).
"""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.types import U8


def uneven(
    image: U8, row_c: float, col_c: float, radius_px: float, loss: float, angle_deg: float
) -> U8:
    """Dim one side, like an ageing LED of the ring:
    by `loss` (a ratio) at its rim, by nothing at the opposite rim.
    """
    rows, cols = np.ogrid[: image.shape[0], : image.shape[1]]
    angle = np.radians(angle_deg)
    along = ((rows - row_c) * np.sin(angle) + (cols - col_c) * np.cos(angle)) / radius_px
    light = np.asarray(1 - loss * np.clip((1 + along) / 2, 0, 1), np.float32)
    if image.ndim == 3:
        light = light[..., None]
    return np.asarray(np.clip(image * light + 0.5, 0, 255), np.uint8)


def glare(image: U8, row: float, col: float, radius_px: float, grey: float = 220.0) -> U8:
    """Add a Gaussian highlight with the standard deviation `radius_px`."""
    rows, cols = np.ogrid[: image.shape[0], : image.shape[1]]
    spot = grey * np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / (2 * radius_px**2))
    if image.ndim == 3:
        spot = spot[..., None]
    return np.asarray(np.clip(image + spot + 0.5, 0, 255), np.uint8)


def speck(image: U8, row: float, col: float, radius_px: float) -> U8:
    """Add a dark spot with a soft edge, like a grain of dust on the camera or a missing marker."""
    reach = math.ceil(radius_px) + 2
    top, left = max(int(row) - reach, 0), max(int(col) - reach, 0)
    made = image.copy()
    part = made[top : max(int(row) + reach, 0), left : max(int(col) + reach, 0)]
    rows, cols = np.ogrid[top : top + part.shape[0], left : left + part.shape[1]]
    cover = np.clip(radius_px + 0.5 - np.hypot(rows - row, cols - col), 0, 1)
    if image.ndim == 3:
        cover = cover[..., None]
    part[...] = np.clip(part * (1 - cover) + 20 * cover + 0.5, 0, 255)
    return made


def noise(image: U8, sigma_grey: float, seed: int) -> U8:
    """Add independent Gaussian noise to every value."""
    draw = np.random.default_rng((seed, 5)).standard_normal(image.shape, np.float32)
    return np.asarray(np.clip(image + sigma_grey * draw + 0.5, 0, 255), np.uint8)


def gain(image: U8, factor: float) -> U8:
    """Multiply the light by a factor (0.9: 10 % dimmer); clips at 255."""
    return np.asarray(np.clip(image.astype(np.float32) * factor + 0.5, 0, 255), np.uint8)


def shift(image: U8, rows: int, cols: int) -> U8:
    """Move the image by whole pixels, repeating its border."""
    height, width = image.shape[:2]
    i = np.clip(np.arange(height) - rows, 0, height - 1)
    j = np.clip(np.arange(width) - cols, 0, width - 1)
    return np.asarray(image[i][:, j], np.uint8)
