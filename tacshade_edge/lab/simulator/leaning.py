"""How a dome or a pad gives way as a whole: it leans, and bulges beside what presses it.

A dome leans like a short beam (`leant_mm`). Full of gel, it keeps its volume and bulges around
objects (`bulged_mm`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.sensor_model import RIM_HALF_ANGLE_DEG
from tacshade_edge.lab.simulator.skin import mass_weight, obstacle_of, undeformed
from tacshade_edge.types import F64


def leant_mm(direction: F64, sway_mm: F64) -> F64:
    """Displacement (..., 3) of the leaning dome's skin at unit vectors (..., 3), for a sway (2,) at
    the apex: the dome shears from the rim up and turns by half as much, like a beam that is as long
    as it is wide.
    """
    low = math.cos(math.radians(RIM_HALF_ANGLE_DEG))
    up = np.clip((direction[..., 2] - low) / (1 - low), 0, 1)
    # Nothing moves at the rim.
    turn = np.minimum(up / 0.1, 1) * (direction[..., :2] @ sway_mm) * (0.5 / (1 - low))
    return np.concatenate((up[..., None] * sway_mm, -turn[..., None]), axis=-1)


def swayed_mm(points_mm: F64, sway_mm: F64, size_mm: float) -> F64:
    """Displacement (..., 3) of a pad's skin at points (..., 3), for a sway (2,) in the middle: it
    shears along itself, and is held at its rim.
    """
    # The rim of the chart, as on a dome of this size: pads and domes share their grid.
    rim_mm = 2 * size_mm * math.tan(math.radians(RIM_HALF_ANGLE_DEG / 2))
    part = np.maximum(1 - np.sum(points_mm[..., :2] ** 2, axis=-1) / rim_mm**2, 0)
    along = part[..., None] * sway_mm
    return np.concatenate((along, np.zeros((*part.shape, 1))), axis=-1)


def bulged_mm(direction: F64, volume_mm3: float, radius_mm: float) -> F64:
    """The outward displacement of the dome's sides, (..., 3) mm, at unit vectors (..., 3),
    by `volume_mm3` in total.
    """
    rim = math.radians(RIM_HALF_ANGLE_DEG)
    angle = np.minimum(np.arccos(np.clip(direction[..., 2], -1, 1)) / rim, 1)
    # sin² vanishes with its slope at the apex and at the clamped rim, so the bulge adds no crease.
    inner = np.linspace(0, rim, 200)
    area_mm2 = (
        2
        * math.pi
        * radius_mm**2
        * float(np.mean(np.sin(math.pi * inner / rim) ** 2 * np.sin(inner)))
        * rim
    )
    return np.asarray((volume_mm3 / area_mm2 * np.sin(math.pi * angle) ** 2)[..., None] * direction)


def displaced_mm3(radius_mm: float, presses: Sequence[Press]) -> float:
    """Volume of the objects inside the undeformed skin, as seen from O; to first order in h."""
    obstacle = obstacle_of(radius_mm, presses)
    step_mm = undeformed(radius_mm).step_mm
    weight = mass_weight(
        # Inside the rim, equal to the weight of the area.
        radius_mm,
        step_mm,
        len(obstacle) // 2,
    )
    return float(np.sum(obstacle * np.minimum(weight, 1))) * step_mm**2
