"""Section IV-A of the paper: from an image to the white ratio, its denoising, and its change."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from tacshade_edge.core.disc import Grid
from tacshade_edge.core.total_variation import chambolle
from tacshade_edge.types import F32, U8, Binarisation, Bool

# The adaptive threshold looks this many marker pitches wide: wide enough to hold black and white everywhere,
# narrow enough to follow vignetting.
ADAPTIVE_PITCHES = 4
# Below this part of the disc's mean grey nothing is white, however dark its surroundings.
ADAPTIVE_FLOOR = 0.6


def to_grey(image: U8) -> U8:
    """Grey image of a grey (H, W) or BGR (H, W, 3) one; uint8, 0 to 255."""
    if image.ndim == 2:
        return image
    grey: U8 = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return grey


def odd(size: float) -> int:
    """Nearest odd whole number, at least 1: a box with a middle."""
    return max(2 * round((size - 1) / 2) + 1, 1)


def binarise(grey: U8, mask: U8, method: Binarisation, pitch_px: float) -> U8:
    """Black and white of a tactile image, Fig. 4(b); 0 outside the disc.

    Parameters
    ----------
    grey : uint8 (H, W)
    mask : uint8 (H, W)
        1 inside the disc, 0 outside.
    method : str
        ``adaptive``: against the mean of the neighbourhood inside the disc, so that uneven light does not
        matter; ``global``: against the mean of the disc; ``otsu``: against the disc's best split.
    pitch_px : float
        Marker pitch.

    Returns
    -------
    uint8 (H, W)
        1 where white.
    """
    inside = cv2.countNonZero(mask)
    if inside == 0:
        return np.zeros_like(grey)
    mean = cv2.mean(grey, mask=mask)[0]
    if method == "adaptive":
        size = odd(ADAPTIVE_PITCHES * pitch_px)
        # Only the disc counts in the mean: a bright surround would blacken the rim.
        masked = cv2.multiply(grey, mask)
        total = cv2.boxFilter(masked, cv2.CV_32F, (size, size), normalize=False, borderType=cv2.BORDER_CONSTANT)
        count = cv2.boxFilter(mask, cv2.CV_32F, (size, size), normalize=False, borderType=cv2.BORDER_CONSTANT)
        local = cv2.divide(total, cv2.max(count, np.ones_like(count)))
        white = (grey > cv2.max(local, np.full_like(local, ADAPTIVE_FLOOR * mean))).astype(np.uint8)
    elif method == "global":
        white = cv2.threshold(grey, mean, 1, cv2.THRESH_BINARY)[1]
    else:
        split = cv2.threshold(grey[mask > 0].reshape(-1, 1), 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0]
        white = cv2.threshold(grey, split, 1, cv2.THRESH_BINARY)[1]
    result: U8 = cv2.multiply(white, mask)
    return result


def box_sums(values: U8, window_px: int, grid: Grid) -> F32:
    """Sum over a box of `window_px` around each cell of `grid`; exact integers below 2**24.

    Parameters
    ----------
    values : uint8 (H, W)

    Returns
    -------
    float32 (rows, cols)
    """
    kernel = (window_px, window_px)
    # u16 holds a box of ones up to 255 px; wider boxes and grey values need 32 bits.
    small = window_px <= 255 and (values.size == 0 or int(values.max()) <= 1)
    depth = cv2.CV_16U if small else cv2.CV_32F
    sums = cv2.boxFilter(values, depth, kernel, normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(sample(sums, grid), dtype=np.float32)


def sample(image: Any, grid: Grid) -> Any:
    """Values of an image at the cells of a grid."""
    step, row0, col0 = int(grid.step_px), int(grid.row0), int(grid.col0)
    return image[row0 : row0 + step * grid.rows : step, col0 : col0 + step * grid.cols : step]


def white_ratio(white: U8, total: F32, window_px: int, grid: Grid, full_scale: float = 255.0) -> F32:
    """Eq. 1: ĝ = 255 s_w / s_t in a square window, at each cell of `grid`.

    Only pixels inside the disc count, in s_w and in s_t, so the disc's rim is not darker than its middle.

    Parameters
    ----------
    white : uint8 (H, W)
        White pixels, 0 outside the disc: 0 or 1, or a mean of binarised images 0 to 255 (see `full_scale`).
    total : float32 (rows, cols)
        s_t: `box_sums` of the disc's mask with the same window.
    full_scale : float
        255 for a `white` of 0 and 1; 1 for a `white` of 0 to 255.

    Returns
    -------
    float32 (rows, cols), 0 to 255; 0 where the window holds no pixel of the disc.
    """
    g: F32 = (full_scale * box_sums(white, window_px, grid) / np.maximum(total, 1)).astype(np.float32)
    return g


def denoise_tv(g: F32, inside: Bool, weight: float) -> F32:
    """Total-variation denoising of the white ratio, Fig. 4(d).

    Outside the disc the mean of the inside stands, so that its edge is not an edge of the image.

    Parameters
    ----------
    g : float32 (rows, cols), 0 to 255
    inside : bool (rows, cols)
    weight : float
        In units of g/255.

    Returns
    -------
    float32 (rows, cols), 0 to 255.
    """
    if weight == 0 or not inside.any():
        return g
    filled: F32 = np.divide(np.where(inside, g, g[inside].mean()), np.float32(255))
    smooth: F32 = (255 * chambolle(filled, weight)).astype(np.float32)
    return smooth


def grey_difference(g: F32, g0: F32, inside: Bool, sign: float) -> F32:
    """Eq. 9, g_d = g - g0, signed so that contact is positive (`sign` -1 for a sensor that darkens).

    Returns
    -------
    float32 (rows, cols), -255 to 255; 0 outside the disc.
    """
    difference: F32 = np.where(inside, np.float32(sign) * (g - g0), np.float32(0))
    return difference


def normalise(values: F32, inside: Bool) -> F32:
    """Min-max over the disc to [0, 1]; all 0 where the values do not differ; 0 outside."""
    if not inside.any():
        return np.zeros_like(values)
    low, high = values[inside].min(), values[inside].max()
    if not high > low:
        return np.zeros_like(values)
    result: F32 = np.where(inside, (values - low) / (high - low), np.float32(0)).astype(np.float32)
    return result


def shape_grey(g_d: F32, g0: F32, inside: Bool) -> F32:
    """Eq. 10 and the normalisation after it: g_hn from g_d and g0.

    Meaningless without contact, where it stretches noise to the full range: gate first.

    Returns
    -------
    float32 (rows, cols), 0 to 1; 0 outside the disc.
    """
    return normalise(normalise(g_d, inside) * g0, inside)
