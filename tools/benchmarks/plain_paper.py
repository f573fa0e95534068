"""The paper's depth as a reader would write it with NumPy, SciPy and scikit-image: the yardstick for `paper`.

It goes equation by equation, with a new array for each result. It settles what the paper leaves open as profile `paper`
does: |N·L| is read as |N||L|, the light is at the camera, start and divisor are those of the code of ref. [20].
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import median_filter
from skimage.restoration import denoise_tv_chambolle

from tacshade_edge.core.depth import Depth
from tacshade_edge.core.depth.hybrid_sfs import C128, EPS, ITERATIONS
from tacshade_edge.core.image.grey_maps import GreyMaps
from tacshade_edge.core.image.greyscale import shape_grey
from tacshade_edge.core.image.total_variation import ITERATIONS_MAX
from tacshade_edge.types import F32, F64


def denoise(image: F32, weight: float, iterations: int = ITERATIONS_MAX) -> F32:
    """The total-variation denoising of Fig. 4(d)."""
    smooth: F32 = denoise_tv_chambolle(image, weight=weight, max_num_iter=iterations)
    return smooth


def solve(maps: GreyMaps, alpha_mm: float) -> Depth:
    """Eqs. 10, 8, 11 and 12, then the 3x3 median of |Z| and α; the maps are those of eqs. 1 and 9."""
    g_hn = shape_grey(maps.g_d, maps.g0, maps.inside)
    with np.errstate(all="ignore"):
        magnitude = np.abs(hybrid_sfs(g_hn.astype(np.float64)))
    good = np.isfinite(magnitude)
    z = median_filter(np.where(good, magnitude, 0), size=3, mode="nearest")
    z = np.where(maps.inside, z, 0)
    return Depth((alpha_mm * z / z.max()).astype(np.float32), saturated=False, repaired_px=int((~good).sum()))


def hybrid_sfs(image: F64) -> C128:
    """Z of eq. 11."""
    p: Any = np.fft.fft2(backward(image, axis=1))
    q: Any = np.fft.fft2(backward(image, axis=0))
    z: Any = image - reflectance(p, q)
    for _ in range(ITERATIONS):
        p, q = backward(z, axis=1), backward(z, axis=0)
        f = image - reflectance(p, q)
        slope = (p + q) / (1 + p**2 + q**2) ** 1.5
        z = z - f / (slope + EPS)
    return z


def reflectance(p: C128, q: C128) -> C128:
    """Eq. 8 for light from the camera, at least 0."""
    r = 1 / (1 + p**2 + q**2) ** 0.5
    return np.where(r.real < 0, 0, r)


def backward(z: C128 | F64, axis: int) -> C128 | F64:
    """Backward differences along an axis, 0 at the first pixel."""
    return np.diff(z, axis=axis, prepend=np.take(z, [0], axis=axis))
