"""Eq. 11 as ref. [20] publishes it, in complex128:
the oracle of `sensor.depth.hybrid_iteration`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from tacshade_edge.sensor.depth.hybrid_iteration import EPS, ITERATIONS
from tacshade_edge.types import F64

C128 = npt.NDArray[np.complex128]


def hybrid_sfs(g_hn: F64, iterations: int = ITERATIONS) -> tuple[F64, int]:
    """Iterate eq. 11 from the initialisation of ref. [20] on g_hn, and take the 3x3 median of |Z|:
    finite, in pixels of arbitrary scale, with the number of values repaired. p and q start as the
    Fourier transforms of the image gradient, as in the reference code. The denominators |N·L| of
    eqs. 4, 7 and 8 are read as |N||L|: as printed, the quotient could only be 1 or -1.
    """
    with np.errstate(all="ignore"):  # overflow is normal for this method
        magnitude = np.abs(_iterate(g_hn.astype(np.complex128), iterations))
    good = np.isfinite(magnitude)
    repaired = int(good.size - np.count_nonzero(good))
    return median_filter(np.where(good, magnitude, 0.0), size=3, mode="nearest"), repaired


def unit_height(g_hn: F64, inside: npt.NDArray[np.bool_], iterations: int = ITERATIONS) -> F64:
    """The result inside the disc, scaled to at most 1; 0 outside and without contrast."""
    found = np.where(inside, hybrid_sfs(g_hn, iterations)[0], 0.0)
    top = found.max(initial=0.0)
    return found / top if top > 0 and g_hn.any() else np.zeros_like(found)


def _backward(z: C128, axis: int) -> C128:
    """Backward difference with a zero first row or column."""
    return np.pad(np.diff(z, axis=axis), ((1, 0), (0, 0)) if axis == 0 else ((0, 0), (1, 0)))


def _iterate(image: C128, iterations: int) -> C128:
    p: C128 = np.fft.fft2(_backward(image, axis=1))
    q: C128 = np.fft.fft2(_backward(image, axis=0))
    z = image
    for n in range(iterations + 1):
        norm2 = 1 + p * p + q * q
        root = np.sqrt(norm2)
        reflectance = np.divide(1, root)
        reflectance[reflectance.real < 0] = 0
        f = image - reflectance
        z = f if n == 0 else z - f / ((p + q) / (norm2 * root) + EPS)
        p, q = _backward(z, axis=1), _backward(z, axis=0)
    return z
