"""Compute the skin's tangential shear by a separate network, trained like that of depth (`learned`).

It runs in addition to depth on request, one for all profiles, and shares nothing with the network of depth, which needs
all its few channels for depth.
"""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np

from tacshade_edge.core.depth.base import Features, ShearNetwork
from tacshade_edge.core.depth.network_maps import fold, known_maps, scale_mm
from tacshade_edge.types import F32, Geometry


class LearnedShear:
    """The network of shear, prepared for one sensor; `reference_white` is as for `LearnedInverse`."""

    def __init__(self, network: ShearNetwork, geometry: Geometry, pitch_px: float, reference_white: F32) -> None:
        self._network = network
        self._mm = scale_mm(geometry)
        self._sensor = network.sense(known_maps(geometry, pitch_px, reference_white, network.fold))

    def __call__(self, white: F32, cells: int, features: Features | None = None) -> F32:
        """Shear along x and y in mm, (cells, cells, 2), finite, from the share of white of a frame (N, N); features go
        to `features`.
        """
        folded = fold(white[None], self._network.fold)
        if features is None or self._network.run_touch is None:
            found = self._network.run(folded, self._sensor)
        else:
            found, some = self._network.run_touch(folded, self._sensor)
            features.append(some)
        coarse = np.ascontiguousarray(np.moveaxis(found, 0, 2))
        if not np.isfinite(coarse).all():
            coarse = np.nan_to_num(coarse, posinf=0.0, neginf=0.0)
        coarse *= self._mm
        return cast(F32, cv2.resize(coarse, (cells, cells), interpolation=cv2.INTER_LINEAR))
