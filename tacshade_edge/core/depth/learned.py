"""The learned inverse of the physical model: white of the frame and of the unloaded skin to height and contact.

The network is trained on simulated sensors alone (tools/train). It sees every sensor on the same square of cells
(`core.geometry.disc_map`) and is told what is known of it; its heights are in tenths of the disc's radius. How it is
run is the caller's choice (`devices.weights.network` takes ONNX Runtime).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.geometry import disc_map
from tacshade_edge.types import F32, Geometry, freeze

KNOWN = 6
"""Maps of `discmap.geometry_maps`."""

HEIGHT_SCALE = 10.0
# On a skin of 20 mm the training presses end at 6.5 mm; what is deeper reads 6.2 to 6.9.
DEEPEST_RADII = 0.31


@dataclass(frozen=True, slots=True)
class Network:
    """A network and how it wants its maps. N = cells / fold.

    Its first layer is linear in what it is given, so what a sensor's reference adds there is the same for every frame.

    Attributes
    ----------
    fold : int
        Each square of fold x fold cells makes as many channels (`fold`).
    sense : callable
        What is known of a sensor, the reference's white folded and `KNOWN` maps, (fold² + KNOWN, N, N), to what it adds
        to the first layer, (channels, N, N).
    run : callable
        A frame's white folded, (fold², N, N), and what `sense` gave, to (2 fold², N, N).
    """

    fold: int
    sense: Callable[[F32], F32]
    run: Callable[[F32, F32], F32]


@dataclass(frozen=True, slots=True, eq=False)
class Inverse:
    """What the network makes of a frame, at the map's cells.

    Attributes
    ----------
    height_mm : float32 (cells, cells)
        h; a little below 0 at times where nothing touches.
    contact_logit : float32 (cells, cells)
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
    reference_white : float32 (cells, cells), 0 to 1
        White of the unloaded skin, on `discmap.map_grid`.
    """

    def __init__(self, network: Network, geometry: Geometry, pitch_px: float, reference_white: F32) -> None:
        self._network = network
        known = disc_map.geometry_maps(geometry, pitch_px, len(reference_white))
        unit_mm = geometry.skin_radius_mm * math.sin(math.radians(geometry.visible_half_angle_deg))
        self._mm = np.float32(unit_mm / HEIGHT_SCALE)
        n = network.fold
        self._sensor = network.sense(np.concatenate((fold(reference_white[None], n), known[:, ::n, ::n])))

    def __call__(self, white: F32) -> Inverse:
        """Run it on a frame's white, float32 (cells, cells), 0 to 1."""
        n = self._network.fold
        height, logit = unfold(self._network.run(fold(white[None], n), self._sensor), n)
        return Inverse(height * self._mm, logit)


def fold(maps: F32, by: int) -> F32:
    """(C, N, N) to (by² C, N/by, N/by): each square of by x by cells becomes as many channels."""
    c, n, _ = maps.shape
    part = n // by
    folded = maps.reshape(c, part, by, part, by).transpose(0, 2, 4, 1, 3)
    return np.ascontiguousarray(folded).reshape(by * by * c, part, part)


def unfold(maps: F32, by: int) -> F32:
    """The inverse of `fold`: (by² C, N/by, N/by) to (C, N, N)."""
    c, part, _ = maps.shape
    unfolded = maps.reshape(c // by**2, by, by, part, part).transpose(0, 3, 1, 4, 2)
    return np.ascontiguousarray(unfolded).reshape(c // by**2, by * part, by * part)
