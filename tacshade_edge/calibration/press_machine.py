"""Place and depth of presses by a machine that shows travel from first touch,
or by a robot on a fixed indenter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.calibration.indenters import skin_z_mm
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F64, frozen


def from_travel(press: KnownPress, skin_radius_mm: float) -> KnownPress:
    """Convert the depth of a press from travel since first touch to that of PRESSES.csv: 0 or less
    if the indenter's lowest point is still above the skin.

    Raises ConfigError if the press states no place over the skin.
    """
    r = skin_radius_mm
    if math.isinf(r):
        # A pad lies flat: travel from first touch is the depth at (x, y) already.
        return press
    # From a depth that certainly touches, because `first_touch_mm` moves the indenter outwards.
    first_mm = replace(press, depth_mm=r / 2).placed(r).first_touch_mm(r)
    if not math.hypot(press.x_mm or 0.0, press.y_mm or 0.0) < r:
        expected = f"expected a place within the skin's radius of {r:g} mm"
        raise ConfigError(
            f"{press.name}: x_mm, y_mm: found {press.x_mm:g}, {press.y_mm:g} mm, {expected}"
        )
    return replace(press, depth_mm=press.depth_mm + first_mm)


@dataclass(frozen=True, slots=True)
class TouchPoint:
    """Place and depth of a press in the sensor frame, as in PRESSES.csv; mm."""

    x_mm: float
    y_mm: float
    depth_mm: float


@frozen
class FixedIndenter:
    """A ball's centre, or another indenter's lowest point, in the base frame;
    the sensor's pose at the stated press.
    """

    point_mm: F64
    ball_radius_mm: float
    base_T_sensor: Rigid

    def turned_deg(self, base_T_sensor: Rigid) -> float:
        """The angle between the sensor's orientation and that at the press with a stated place;
        degrees.
        """
        turn = self.base_T_sensor.rotation.T @ base_T_sensor.rotation
        # Rounding may carry the cosine beyond 1, where acos fails.
        return math.degrees(math.acos(min(max((float(np.trace(turn)) - 1) / 2, -1.0), 1.0)))

    def touch(self, base_T_sensor: Rigid, skin_radius_mm: float) -> TouchPoint:
        """The press of a sensor held at this pose.

        Raises ValueError if the indenter is not over the skin.
        """
        x_mm, y_mm, z_mm = (float(v) for v in base_T_sensor.inverse().apply(self.point_mm))
        return TouchPoint(
            x_mm, y_mm, _over_skin_mm(x_mm, y_mm, skin_radius_mm) - (z_mm - self.ball_radius_mm)
        )


def fixed_indenter(
    base_T_sensor: Rigid, stated: TouchPoint, ball_radius_mm: float, skin_radius_mm: float
) -> FixedIndenter:
    """The indenter that makes the stated press.

    Raises ValueError if the press is not over the skin.
    """
    z_mm = (
        _over_skin_mm(stated.x_mm, stated.y_mm, skin_radius_mm) - stated.depth_mm + ball_radius_mm
    )
    point_mm = base_T_sensor.apply(np.array((stated.x_mm, stated.y_mm, z_mm)))
    return FixedIndenter(point_mm, ball_radius_mm, base_T_sensor)


def _over_skin_mm(x_mm: float, y_mm: float, skin_radius_mm: float) -> float:
    z_mm = skin_z_mm(skin_radius_mm, x_mm, y_mm)
    if not z_mm > 0 and math.isfinite(skin_radius_mm):
        raise ValueError(
            f"x {x_mm:.1f}, y {y_mm:.1f} mm lies outside a skin of radius {skin_radius_mm:g} mm"
        )
    return z_mm
