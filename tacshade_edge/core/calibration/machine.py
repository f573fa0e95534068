"""Place and depth of presses by a machine that shows travel from first touch, or by a robot on a fixed indenter."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.core.calibration.indenters import Ball, Indenter, place
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F64, frozen


def first_touch_mm(
    indenter: Indenter | float, skin_radius_mm: float, x_mm: float, y_mm: float, yaw_deg: float = 0.0
) -> float:
    """Depth, as in PRESSES.csv, at which an indenter, or a ball of a radius, first touches the undeformed skin: at most
    0 for a ball.
    """
    r = skin_radius_mm
    if isinstance(indenter, Indenter):
        return place(indenter, r, x_mm, y_mm, r / 2, yaw_deg).first_touch_mm(r)
    return Ball(x_mm, y_mm, 0.0, indenter).first_touch_mm(r)


def from_travel(press: KnownPress, skin_radius_mm: float) -> KnownPress:
    """Convert the depth of a press from travel since first touch to that of PRESSES.csv: 0 or less if the indenter's
    lowest point is still above the skin. Raises ConfigError if the press states no place, or one that is not over the
    skin.
    """
    if press.x_mm is None or press.y_mm is None:
        raise ConfigError(f"{press.name}: x_mm, y_mm: found no values, expected both values with --depth-from-touch")
    r, x_mm, y_mm = skin_radius_mm, press.x_mm, press.y_mm
    if not x_mm**2 + y_mm**2 < r * r:
        expected = f"expected a place within the skin's radius of {r:g} mm"
        raise ConfigError(f"{press.name}: x_mm, y_mm: found {x_mm:g}, {y_mm:g} mm, {expected}")
    if press.indenter is None:
        first_mm = first_touch_mm(press.radius_mm, r, x_mm, y_mm)
    else:
        angles = press.yaw_deg, press.tilt_x_deg, press.tilt_y_deg
        first_mm = place(press.indenter, r, x_mm, y_mm, r / 2, *angles).first_touch_mm(r)
    return replace(press, depth_mm=press.depth_mm + first_mm)


@dataclass(frozen=True, slots=True)
class Touch:
    """Place and depth of a press in the sensor frame, as in PRESSES.csv; mm."""

    x_mm: float
    y_mm: float
    depth_mm: float


@frozen
class FixedIndenter:
    """An indenter fixed in the base frame: a ball's centre, or another's lowest point (`ball_radius_mm` 0), and the
    pose of the sensor at the press with a stated place.
    """

    point_mm: F64
    ball_radius_mm: float
    base_T_sensor: Rigid

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
