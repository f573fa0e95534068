"""Solve eqs. 8, 11 and 12 as published: the hybrid linear shape from shading of the paper's ref. [20].

A fidelity reference, not a good method: its result is a scaled copy of the grey image (docs/explanation/numerics.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tacshade_edge.core.depth.base import Depth, Features, Mark, Network
from tacshade_edge.core.image.greyscale import shape_grey
from tacshade_edge.core.image.preprocess import GreyMapper, GreyMaps, Preprocessed, Preprocessor
from tacshade_edge.types import F32, F64, Calibration

ITERATIONS = 25
EPS = 2.2e-16

C128 = npt.NDArray[np.complex128]


def _backward(z: C128, axis: int) -> C128:
    """Backward difference with a zero first row or column."""
    return np.pad(np.diff(z, axis=axis), ((1, 0), (0, 0)) if axis == 0 else ((0, 0), (1, 0)))


def hybrid_sfs(g_hn: F64) -> tuple[F64, int]:
    """Run 25 iterations of eq. 11 from the initialisation of ref. [20] on g_hn (0 to 1; any value is accepted), and
    take the 3x3 median of |Z|: finite, in pixels of arbitrary scale, with the number of values repaired. p and q start
    as the Fourier transforms of the image gradient, as in the reference code. The denominators |N·L| of eqs. 4, 7 and 8
    are read as |N||L|: as printed, the quotient could only be 1 or -1.
    """
    from scipy.ndimage import median_filter  # only `paper` needs it

    finite = np.isfinite(g_hn)
    repaired = int(finite.size - np.count_nonzero(finite))
    with np.errstate(
        all="ignore"
    ):  # overflow is normal for this method; it is repaired and counted below
        magnitude = np.abs(_iterate(np.where(finite, g_hn, 0.0).astype(np.complex128)))
    good = np.isfinite(magnitude)
    repaired += int(good.size - np.count_nonzero(good))
    return median_filter(np.where(good, magnitude, 0.0), size=3, mode="nearest"), repaired


def _iterate(image: C128) -> C128:
    """Z of eq. 11, computed in place where possible, because every array of a whole image takes 5 MB."""
    p: C128 = np.fft.fft2(_backward(image, axis=1))
    q: C128 = np.fft.fft2(_backward(image, axis=0))
    z = image
    for n in range(ITERATIONS + 1):
        norm2 = p * p
        norm2 += 1
        norm2 += q * q
        root = np.sqrt(norm2)
        f: C128 = np.divide(1, root)  # the reflectance
        f[f.real < 0] = 0
        np.subtract(image, f, out=f)
        if n == 0:
            z = f
        else:
            norm2 *= root
            p += q
            slope = np.divide(p, norm2, out=norm2)
            slope += EPS
            f /= slope
            z -= f
        p, q = _backward(z, axis=1), _backward(z, axis=0)
    return z


UnitHeight = Callable[[F32], tuple[F64, int]]
"""From g_hn to heights of arbitrary scale, with the number of values repaired."""


def unit_by_eq_11(g_hn: F32) -> tuple[F64, int]:
    """Eq. 11's |Z|, in pixels of arbitrary scale."""
    # The iteration turns an image without contrast into a constant, which is not a height.
    if not g_hn.any():
        return g_hn.astype(np.float64), 0
    return hybrid_sfs(g_hn.astype(np.float64))


def unit_by_grey(g_hn: F32) -> tuple[F64, int]:
    """g_hn itself, as if eq. 11 were left out."""
    return g_hn.astype(np.float64), 0


def hybrid_depth(maps: GreyMaps, alpha_mm: float, unit_height: UnitHeight = unit_by_eq_11) -> Depth:
    """The paper's height: g_hn (eq. 10), eq. 11, then α, the depth for a normalised height of 1."""
    g_hn, bad = finite_shape_grey(maps)
    z, repaired = unit_height(g_hn)
    z = np.where(maps.inside, z, 0.0)
    top = float(z.max(initial=0.0))
    return scaled(z / top if top > 0 else z, alpha_mm, repaired + bad)


def finite_shape_grey(maps: GreyMaps) -> tuple[F32, int]:
    """Eq. 10 with 0 where g_d or g_0 is not finite, and the number of such cells."""
    finite = np.isfinite(maps.g_d) & np.isfinite(maps.g0)
    g_d, g0 = (
        np.where(finite, np.clip(values, low, 255), np.float32(0))
        for values, low in ((maps.g_d, -255), (maps.g0, 0))
    )
    return shape_grey(g_d, g0, maps.inside), int(finite.size - np.count_nonzero(finite))


def scaled(unit: F64, alpha_mm: float, repaired_px: int) -> Depth:
    """Depth from α times heights of 0 to 1, clipped to float32."""
    height: F32 = np.minimum(alpha_mm * unit, np.finfo(np.float32).max).astype(np.float32)
    return Depth(height_mm=height, repaired_px=repaired_px)


def with_own_ratio(calibration: Calibration, depth_mm: float) -> Calibration:
    """The calibration with the α of one press, "the ratio between the ground-truth contact depth and the maximum
    estimated depth" (section IV-C): its greatest height becomes `depth_mm`.
    """
    return replace(calibration, alpha=depth_mm / calibration.geometry.mm_per_px)


class HybridSfs:
    """Solves by denoising, eq. 9, and `hybrid_depth`, without a network."""

    def __init__(
        self,
        preprocessor: Preprocessor,
        network: Network | None = None,
        unit_height: UnitHeight = unit_by_eq_11,
    ) -> None:
        self._unit_height = unit_height
        self.grid = preprocessor.camera_grid
        self._grey_mapper = GreyMapper(preprocessor)
        # α is per pixel of the image (the paper ties it to the image's resolution).
        self._alpha_mm = preprocessor.camera.alpha * preprocessor.camera.geometry.mm_per_px

    def solve(
        self, preprocessed: Preprocessed, mark: Mark, features: Features | None = None
    ) -> Depth:
        maps = self._grey_mapper.maps(preprocessed)
        mark("denoise")
        return hybrid_depth(maps, self._alpha_mm, self._unit_height)

    def shear_mm(self, preprocessed: Preprocessed, features: Features | None = None) -> None:
        """The paper has no shear."""
