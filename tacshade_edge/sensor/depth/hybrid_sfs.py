"""Solve eqs. 8, 11 and 12 as published: the hybrid linear shape from shading of the paper's ref.
[20].

A fidelity reference, not a good method: its result is a scaled copy of the grey image
(docs/explanation/numerics.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tacshade_edge.sensor.depth.hybrid_iteration import HybridIteration
from tacshade_edge.sensor.depth.solver import Depth, Features, Mark, Network
from tacshade_edge.sensor.image.greyscale import shape_grey
from tacshade_edge.sensor.image.preprocess import GreyMapper, GreyMaps, Preprocessed, Preprocessor
from tacshade_edge.types import F32, Bool, Calibration

UnitHeight = Callable[[F32, Bool], tuple[F32, int]]
"""From g_hn and the disc to heights of arbitrary scale, with the number of values repaired."""


def unit_by_grey(g_hn: F32, inside: Bool) -> tuple[F32, int]:
    """g_hn itself, as if eq. 11 were left out."""
    return g_hn, 0


def hybrid_depth(maps: GreyMaps, alpha_mm: float, unit_height: UnitHeight) -> Depth:
    """The paper's height: g_hn (eq. 10), eq. 11, then α, the depth for a normalised height of 1."""
    g_hn, bad = finite_shape_grey(maps)
    found, repaired = unit_height(g_hn, maps.inside)
    z = np.where(maps.inside, found, 0).astype(np.float64)
    # Eq. 11 has no scale of its own: the greatest height of every contact becomes α.
    top = float(z.max(initial=0.0))
    height = np.minimum(alpha_mm * (z / top if top > 0 else z), np.finfo(np.float32).max)
    return Depth(height_mm=height.astype(np.float32), repaired_px=repaired + bad)


def finite_shape_grey(maps: GreyMaps) -> tuple[F32, int]:
    """Eq. 10 with 0 where g_d or g_0 is not finite, and the number of such cells."""
    finite = np.isfinite(maps.g_d) & np.isfinite(maps.g0)
    g_d, g0 = (
        np.where(finite, np.clip(values, low, 255), np.float32(0))
        for values, low in ((maps.g_d, -255), (maps.g0, 0))
    )
    return shape_grey(g_d, g0, maps.inside), int(finite.size - np.count_nonzero(finite))


def with_own_ratio(calibration: Calibration, depth_mm: float) -> Calibration:
    """The calibration with the α of one press, "the ratio between the ground-truth contact depth
    and the maximum estimated depth" (section IV-C): its greatest height becomes `depth_mm`.
    """
    alpha = depth_mm / calibration.geometry.mm_per_px
    return replace(calibration, alpha=alpha, alpha_grey=0.0)


def change_grey(maps: GreyMaps) -> float:
    """RMS of eq. 9's g_d over the disc, 0 to 255 grey levels;
    a value that is not finite counts as 0.
    """
    g_d = np.clip(np.nan_to_num(maps.g_d[maps.inside]), -255, 255)
    return float(np.sqrt(np.square(g_d, dtype=np.float64).mean())) if g_d.size else 0.0


class HybridSfs:
    """Solves by denoising, eq. 9, and `hybrid_depth`, without a network."""

    def __init__(
        self,
        preprocessor: Preprocessor,
        network: Network | None = None,
        make_unit: Callable[[tuple[int, int]], UnitHeight] = HybridIteration,
    ) -> None:
        self.grid = preprocessor.camera_grid
        self._unit_height = make_unit((self.grid.rows, self.grid.cols))
        self._grey_mapper = GreyMapper(preprocessor)
        # α is per pixel of the image (the paper ties it to the image's resolution).
        self._alpha_mm = preprocessor.camera.alpha * preprocessor.camera.geometry.mm_per_px
        self._alpha_grey = preprocessor.camera.alpha_grey

    def solve(
        self, preprocessed: Preprocessed, mark: Mark, features: Features | None = None
    ) -> Depth:
        """Depth of an image on `grid`; only its heights show the contact."""
        maps = self._grey_mapper.maps(preprocessed)
        mark("denoise")
        # Eq. 10 normalises the depth away; what grows with it is how much the whole skin changed.
        times = change_grey(maps) / self._alpha_grey if self._alpha_grey else 1.0
        return hybrid_depth(maps, times * self._alpha_mm, self._unit_height)

    def shear_mm(self, preprocessed: Preprocessed, features: Features | None = None) -> None:
        """The paper has no shear."""
