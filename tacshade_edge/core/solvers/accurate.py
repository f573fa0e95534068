"""The learned inverse of the physical model: white of the frame and of the unloaded skin to height and contact.

The network is trained on simulated sensors alone (tools/train). It sees every sensor on the same square of cells
(`core.discmap`) and is told what is known of it; its heights are in tenths of the disc's radius. How it is run is the
caller's choice (`devices.network` takes OpenCV's DNN module).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core import discmap
from tacshade_edge.types import F32, U8, Geometry, freeze

Network = Callable[[F32], F32]
"""Maps (14, CELLS/2, CELLS/2) to (8, CELLS/2, CELLS/2)."""

HEIGHT_SCALE = 10.0
# On a skin of 20 mm the training presses end at 6.5 mm; deeper answers are extrapolated.
DEEPEST_RADII = 0.325


@dataclass(frozen=True, slots=True, eq=False)
class Inverse:
    """What the network makes of a frame, at the map's cells.

    Attributes
    ----------
    height_mm : float32 (CELLS, CELLS)
        h; a little below 0 at times where nothing touches.
    contact_logit : float32 (CELLS, CELLS)
        Log odds that the skin touches an object.
    """

    height_mm: F32
    contact_logit: F32

    def __post_init__(self) -> None:
        freeze(self, "height_mm", "contact_logit")


class LearnedInverse:
    """The network, prepared for one sensor.

    Parameters
    ----------
    network : Network
    geometry : Geometry
    pitch_px : float
    reference_white : uint8 (H, W), 0 to 255
        `Calibration.reference_white`.
    """

    def __init__(self, network: Network, geometry: Geometry, pitch_px: float, reference_white: U8) -> None:
        self._network = network
        self._disc = geometry.disc
        self.known = discmap.geometry_maps(geometry, pitch_px)
        self._unit_mm = geometry.skin_radius_mm * math.sin(math.radians(geometry.visible_half_angle_deg))
        reference = fold(discmap.disc_average(reference_white, geometry.disc)[None] / np.float32(255))
        # The frame's four channels come first; the rest stays.
        self._still = np.concatenate((reference, self.known[:, ::2, ::2]))

    def __call__(self, white: U8) -> Inverse:
        """Run it on a binarised frame, uint8 (H, W), 0 or 1."""
        frame = fold(discmap.disc_average(white, self._disc)[None])
        height, logit = unfold(self._network(np.concatenate((frame, self._still))))
        return Inverse(height * np.float32(self._unit_mm / HEIGHT_SCALE), logit)


def fold(maps: F32) -> F32:
    """(C, N, N) to (4 C, N/2, N/2): each square of four cells becomes four channels."""
    c, n, _ = maps.shape
    half = n // 2
    return np.ascontiguousarray(maps.reshape(c, half, 2, half, 2).transpose(0, 2, 4, 1, 3)).reshape(4 * c, half, half)


def unfold(maps: F32) -> F32:
    """The inverse of `fold`: (4 C, N/2, N/2) to (C, N, N)."""
    c, half, _ = maps.shape
    folded = maps.reshape(c // 4, 2, 2, half, half).transpose(0, 3, 1, 4, 2)
    return np.ascontiguousarray(folded).reshape(c // 4, 2 * half, 2 * half)
