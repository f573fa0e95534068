"""The equations of section IV-A of the paper: the white ratio, its denoising, and its change."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from tacshade_edge.core.image.total_variation import chambolle
from tacshade_edge.types import F32, U8, Bool

Denoiser = Callable[[F32, float], F32]
"""Total-variation denoising of an image of 0 to 1 with a weight."""


def to_grey(image: U8, space: U8 | None = None) -> U8:
    """Convert a grey (H, W) or BGR (H, W, 3) image to grey; uint8, 0 to 255. The result may use `space`, (H, W)."""
    if image.ndim == 2:
        return image
    grey: U8 = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY, dst=space)
    return grey


def white_ratio(white_sum: F32, total: F32, full_scale: float = 255.0) -> F32:
    """Eq. 1: ĝ = 255 s_w / s_t in a square window, at each cell of a grid.

    Only pixels inside the disc count, in s_w and in s_t, so the disc's rim is not darker than its middle.

    Parameters
    ----------
    white_sum : float32 (rows, cols)
        s_w, the white pixels in the window: sums of 0 and 1, or of mean images of 0 to 255 (see `full_scale`).
    total : float32 (rows, cols)
        s_t, the disc's pixels in the window.
    full_scale : float
        255 for sums of 0 and 1; 1 for sums of 0 to 255.

    Returns
    -------
    float32 (rows, cols), 0 to 255; 0 where the window holds no pixel of the disc.
    """
    g: F32 = (np.float32(full_scale) * white_sum / np.maximum(total, np.float32(1))).astype(np.float32)
    return g


def denoise_tv(g: F32, inside: Bool, weight: float, denoise: Denoiser = chambolle) -> F32:
    """Total-variation denoising of the white ratio, Fig. 4(d).

    The mean of the inside fills the outside of the disc, so that its rim is not an edge of the image.

    Parameters
    ----------
    g : float32 (rows, cols), 0 to 255
    inside : bool (rows, cols)
    weight : float
        In units of g/255; 0 leaves the map unchanged.
    denoise : callable

    Returns
    -------
    float32 (rows, cols), 0 to 255.
    """
    if weight == 0 or not inside.any():
        return g
    filled: F32 = np.divide(np.where(inside, g, g[inside].mean()), np.float32(255))
    smooth: F32 = (255 * denoise(filled, weight)).astype(np.float32)
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
    """Scale values by min-max over the disc to [0, 1]; 0 outside, and all 0 if the values do not differ."""
    if not inside.any():
        return np.zeros_like(values)
    low, high = values[inside].min(), values[inside].max()
    if not high > low:
        return np.zeros_like(values)
    result = np.zeros(values.shape, np.float32)
    np.divide(values - low, high - low, out=result, where=inside)  # a quotient outside may overflow float32
    return result


def shape_grey(g_d: F32, g0: F32, inside: Bool) -> F32:
    """Eq. 10 and the normalisation after it: g_hn from g_d and g0.

    Apply the gate first: without contact this stretches noise to the full range.

    Returns
    -------
    float32 (rows, cols), 0 to 1; 0 outside the disc.
    """
    return normalise(normalise(g_d, inside) * g0, inside)
