"""Place and depth of a press from where a robot held the sensor: the indenter stands still in the base frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F64, freeze


@dataclass(frozen=True, slots=True)
class Touch:
    """A press in the sensor frame, as PRESSES.csv has it; mm."""

    x_mm: float
    y_mm: float
    depth_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class FixedIndenter:
    """Where an indenter stands.

    Attributes
    ----------
    point_mm : float64 (3,)
        In the base frame: a ball's centre, or the lowest point of another.
    ball_radius_mm : float
        0 for another.
    base_T_sensor : Rigid
        At the press that stated it.
    """

    point_mm: F64
    ball_radius_mm: float
    base_T_sensor: Rigid

    def __post_init__(self) -> None:
        freeze(self, "point_mm")

    def turned_deg(self, base_T_sensor: Rigid) -> float:
        """How far the sensor is turned against the press that stated the place; degrees."""
        turn = self.base_T_sensor.rotation.T @ base_T_sensor.rotation
        return math.degrees(math.acos(min(max((float(np.trace(turn)) - 1) / 2, -1.0), 1.0)))

    def touch(self, base_T_sensor: Rigid, skin_radius_mm: float) -> Touch:
        """The press of a sensor that is held there.

        Raises
        ------
        ValueError
            The indenter is beside the skin.
        """
        x_mm, y_mm, z_mm = (float(v) for v in base_T_sensor.inverse().apply(self.point_mm))
        lowest_mm = z_mm - self.ball_radius_mm
        return Touch(x_mm, y_mm, _skin_z_mm(x_mm, y_mm, skin_radius_mm) - lowest_mm)


def fixed_indenter(base_T_sensor: Rigid, stated: Touch, ball_radius_mm: float, skin_radius_mm: float) -> FixedIndenter:
    """Where an indenter stands that presses so; the inverse of `FixedIndenter.touch`.

    Raises
    ------
    ValueError
        The press is beside the skin.
    """
    z_mm = _skin_z_mm(stated.x_mm, stated.y_mm, skin_radius_mm) - stated.depth_mm + ball_radius_mm
    point_mm = base_T_sensor.apply(np.array((stated.x_mm, stated.y_mm, z_mm)))
    return FixedIndenter(point_mm, ball_radius_mm, base_T_sensor)


def _skin_z_mm(x_mm: float, y_mm: float, skin_radius_mm: float) -> float:
    """Of the undeformed skin."""
    square = skin_radius_mm**2 - x_mm**2 - y_mm**2
    if not square > 0:
        raise ValueError(f"x {x_mm:.1f}, y {y_mm:.1f} mm lies outside a skin of radius {skin_radius_mm:g} mm")
    return math.sqrt(square)
