"""Compute place and depth of a press on a fixed indenter from the pose of the sensor that a robot holds."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F64, freeze


@dataclass(frozen=True, slots=True)
class Touch:
    """Place and depth of a press in the sensor frame, as in PRESSES.csv; mm."""

    x_mm: float
    y_mm: float
    depth_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class FixedIndenter:
    """An indenter fixed in the base frame: a ball's centre, or another's lowest point (`ball_radius_mm` 0), and the
    pose of the sensor at the press with a stated place.
    """

    point_mm: F64
    ball_radius_mm: float
    base_T_sensor: Rigid

    def __post_init__(self) -> None:
        freeze(self, "point_mm")

    def turned_deg(self, base_T_sensor: Rigid) -> float:
        """The angle between the sensor's orientation and that at the press with a stated place; degrees."""
        turn = self.base_T_sensor.rotation.T @ base_T_sensor.rotation
        return math.degrees(math.acos(min(max((float(np.trace(turn)) - 1) / 2, -1.0), 1.0)))

    def touch(self, base_T_sensor: Rigid, skin_radius_mm: float) -> Touch:
        """The press of a sensor held at this pose. Raises ValueError if the indenter is not over the skin."""
        x_mm, y_mm, z_mm = (float(v) for v in base_T_sensor.inverse().apply(self.point_mm))
        lowest_mm = z_mm - self.ball_radius_mm
        return Touch(x_mm, y_mm, _skin_z_mm(x_mm, y_mm, skin_radius_mm) - lowest_mm)


def fixed_indenter(base_T_sensor: Rigid, stated: Touch, ball_radius_mm: float, skin_radius_mm: float) -> FixedIndenter:
    """The indenter that makes the stated press; the inverse of `FixedIndenter.touch`. Raises ValueError if the press is
    not over the skin.
    """
    z_mm = _skin_z_mm(stated.x_mm, stated.y_mm, skin_radius_mm) - stated.depth_mm + ball_radius_mm
    point_mm = base_T_sensor.apply(np.array((stated.x_mm, stated.y_mm, z_mm)))
    return FixedIndenter(point_mm, ball_radius_mm, base_T_sensor)


def _skin_z_mm(x_mm: float, y_mm: float, skin_radius_mm: float) -> float:
    """The undeformed skin's z at (x, y), mm."""
    square = skin_radius_mm**2 - x_mm**2 - y_mm**2
    if not square > 0:
        raise ValueError(f"x {x_mm:.1f}, y {y_mm:.1f} mm lies outside a skin of radius {skin_radius_mm:g} mm")
    return math.sqrt(square)
