"""The equations of section IV-A of the paper: the white ratio, its denoising by total variation,
and its change.
"""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np

from tacshade_edge.types import F32, F64, U8, Bool

Floats = TypeVar("Floats", F32, F64)

ITERATIONS_MAX = 200
# The iteration ends when the cost falls by less than this part of its first value.
ENOUGH = 2.0e-4
_TAU = 0.25  # the step, 1 / (2 dimensions)
_GREY_AXES = 2  # of an image without colours


def to_grey(image: U8, space: U8 | None = None) -> U8:
    """Convert a grey (H, W) or BGR (H, W, 3) image to grey; uint8, 0 to 255.

    The result may use `space`, (H, W).
    """
    if image.ndim == _GREY_AXES:
        return image
    grey: U8 = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY, dst=space)
    return grey


def chambolle(image: Floats, weight: float, iterations: int = ITERATIONS_MAX) -> Floats:
    """Compute the image u that minimises the sum of ‖∇u‖ + (u - image)² / (2 weight) (Rudin, Osher
    and Fatemi; A. Chambolle, J. Math. Imaging Vis. 20, 2004). Operations and order are those of
    scikit-image's, so the bits are the same, without its import, which costs 60 MB and a second.
    """
    # The rows are flattened, so that a shift of the whole gives the neighbours: NumPy is several
    # times slower on slices of a two-dimensional array. A 0 precedes the first row and pixel.
    cols, count, dtype = image.shape[1], image.size, image.dtype
    source = u = image.ravel()
    p_down, p_right = np.zeros(cols + count, dtype), np.zeros(1 + count, dtype)
    gradient = np.zeros((2, count), dtype)
    down, right = gradient
    divergence, norm, squares, moved = (np.zeros(count, dtype) for _ in range(4))
    first = previous = dtype.type(0)
    for i in range(iterations):
        if i > 0:
            np.add(p_down[cols:], p_right[1:], out=divergence)
            np.subtract(p_down[:count], divergence, out=divergence)
            divergence += p_right[:count]
            u = np.add(source, divergence, out=moved)
        np.subtract(u[cols:], u[:-cols], out=down[:-cols])
        np.subtract(u[1:], u[:-1], out=right[:-1])
        right[cols - 1 :: cols] = 0
        np.square(down, out=norm)
        norm += np.square(right, out=squares)
        np.sqrt(norm, out=norm)
        cost = (np.square(divergence, out=squares).sum() + weight * norm.sum()) / float(count)
        if i == 0:
            first = cost
        elif abs(previous - cost) < ENOUGH * first:
            break
        previous = cost
        norm *= _TAU / weight
        norm += 1
        gradient *= _TAU
        for p, step in ((p_down[cols:], down), (p_right[1:], right)):
            p -= step
            p /= norm
    return u.reshape(image.shape)


def denoise_tv(g: F32, inside: Bool, weight: float) -> F32:
    """Total-variation denoising of the white ratio, Fig. 4(d), with `weight` in units of g/255; 0
    leaves it unchanged. The mean of the inside fills the outside of the disc, so that its rim is
    not an edge.
    """
    if weight == 0 or not inside.any():
        return g
    filled: F32 = np.divide(np.where(inside, g, g[inside].mean()), np.float32(255))
    smooth: F32 = (255 * chambolle(filled, weight)).astype(np.float32)
    return smooth


def grey_difference(g: F32, g0: F32, inside: Bool, sign: float) -> F32:
    """Eq. 9, g_d = g - g0, signed so that contact is positive; 0 outside the disc."""
    difference: F32 = np.where(inside, np.float32(sign) * (g - g0), np.float32(0))
    return difference


def normalise(values: F32, inside: Bool) -> F32:
    """Scale values by min-max over the disc to [0, 1];
    0 outside, and all 0 if the values do not differ.
    """
    if not inside.any():
        return np.zeros_like(values)
    low, high = values[inside].min(), values[inside].max()
    if not high > low:
        return np.zeros_like(values)
    result = np.zeros(values.shape, np.float32)
    np.divide(
        values - low, high - low, out=result, where=inside
    )  # a quotient outside may overflow float32
    return result


def shape_grey(g_d: F32, g0: F32, inside: Bool) -> F32:
    """Eq. 10 and its normalisation: g_hn, 0 to 1.

    Apply the gate first: without contact this stretches noise to it.
    """
    return normalise(normalise(g_d, inside) * g0, inside)
