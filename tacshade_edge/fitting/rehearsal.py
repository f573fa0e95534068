"""Simulated frames of other sensors, with which a fit rehearses what the shipped networks know.

Presses of one sensor do not show how to read other objects, deeper contacts or drags. Without rehearsal, a network
forgets some of that (A. Robins, "Catastrophic forgetting, rehearsal and pseudorehearsal", Connection Science 7, 1995).
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from tacshade_edge.core.depth import Network
from tacshade_edge.core.depth.network_maps import fold, known_maps
from tacshade_edge.types import F32, U8, Disc, Geometry

FILE = Path(str(resources.files("tacshade_edge.fitting") / "rehearsal.npz"))
"""Written by tools/training/rehearsal.py: maps of 112x112 cells."""
LEVEL = 17
"""255ths of white for each level in the file, which are 0 to 15."""


@dataclass(frozen=True, slots=True, eq=False)
class Rehearsal:
    """Frames as a network receives them.

    Attributes
    ----------
    white : Tensor float32 (F, fold², N, N)
        0 to 1.
    sensors : Tensor float32 (S, channels, N, N)
        What each sensor adds to the first layer of the shipped network.
    sensor : Tensor int64 (F,)
        Each frame's number in `sensors`.
    """

    white: Tensor
    sensors: Tensor
    sensor: Tensor

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.white)


def rehearsal(network: Network, cells: int) -> Rehearsal:
    """Read the frames for a shipped network with maps of `cells` a side."""
    with np.load(FILE) as file:
        geometry, reference, frame = file["geometry"], file["reference"], file["frame"]
    by = network.fold
    white = [fold(each[None], by) for each in _white(frame, cells).reshape(-1, cells, cells)]
    sensors = [
        network.sense(known_maps(_geometry(*row), float(row[3]), at_rest, by))
        for row, at_rest in zip(geometry, _white(reference, cells), strict=True)
    ]
    number = torch.arange(len(sensors)).repeat_interleave(frame.shape[1])
    return Rehearsal(torch.from_numpy(np.stack(white)), torch.from_numpy(np.stack(sensors)), number)


def _white(levels: U8, cells: int) -> F32:
    """White of maps (..., cells, cells), 0 to 1."""
    by = levels.shape[-1] // cells
    each = levels.reshape(*levels.shape[:-2], cells, by, cells, by)
    return np.asarray(each.mean((-3, -1)) * (LEVEL / 255), dtype=np.float32)


def _geometry(skin_radius_mm: float, camera_distance_mm: float, visible_half_angle_deg: float, _: float) -> Geometry:
    """The geometry of a sensor whose disc has a radius of one pixel."""
    distance_mm = None if np.isnan(camera_distance_mm) else float(camera_distance_mm)
    return Geometry(float(skin_radius_mm), distance_mm, float(visible_half_angle_deg), Disc(0.0, 0.0, 1.0))
