"""Place and depth of presses by a machine over the sensor, or by a robot that holds it to a fixed indenter.

Under a machine the sensor's axis is upright: the sensor frame is the machine's, shifted and turned about z by a yaw.
The head's place is that of the ball's lowest point; places at which a ball first touched the skin show the sensor's
pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.core.calibration.indenters import Ball, Indenter, place
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.types import F64, frozen

_ITERATIONS = 20
# Touches that miss a sphere by more than the first (RMS, skin radii) are not of that skin; pictured places further than
# the second from where the ball was (RMS, as part of its RMS distance from the axis) are not of this sensor.
_MOST_RMS, _MOST_PICTURED_RMS = 0.004, 0.2
_PICTURED_SCALE = (0.6, 1.6)  # true distance from the axis over the pictured one


def skin_centre(touches_mm: F64, skin_radius_mm: float, ball_radius_mm: float) -> tuple[F64, float]:
    """Fit the centre (3,) of the undeformed skin, and the RMS distance of the touches from it (Gauss-Newton): the
    ball's centre touches at the sum of both radii. Takes the head's place at touches (N, 3), N at least 4, not all in a
    line; raises ConfigError if they do not lie on such a skin.
    """
    balls_mm = touches_mm + np.array((0.0, 0.0, ball_radius_mm))
    reach_mm = skin_radius_mm + ball_radius_mm
    centre = np.append(touches_mm[:, :2].mean(axis=0), touches_mm[:, 2].max() - skin_radius_mm)
    for _ in range(_ITERATIONS):
        towards = balls_mm - centre
        distance = np.maximum(np.linalg.norm(towards, axis=1), 1e-9)
        centre = centre + np.linalg.lstsq(towards / distance[:, None], distance - reach_mm, rcond=None)[0]
    rms_mm = float(np.sqrt(np.mean((np.linalg.norm(balls_mm - centre, axis=1) - reach_mm) ** 2)))
    if not rms_mm <= _MOST_RMS * skin_radius_mm:
        asked = (
            f"is the skin upright, and are the radii right (skin {skin_radius_mm:g} mm, ball {ball_radius_mm:g} mm)?"
        )
        expected = f"expected at most {_MOST_RMS * skin_radius_mm:.2f} mm"
        raise ConfigError(
            f"found first touches that deviate from a sphere by {rms_mm:.2f} mm (RMS), {expected}; {asked}"
        )
    return centre, rms_mm


def yaw_of(places_mm: F64, pictured_mm: F64) -> float:
    """Fit the angle in rad by which the sensor frame is turned about z in the machine's, from x towards y, from a
    ball's places (N, 2) in the machine's frame, relative to the skin's axis, and in the pictures. Raises ConfigError if
    these show others.
    """
    shown, put = pictured_mm @ (1, 1j), places_mm @ (1, 1j)
    turned, mirrored = (float(abs(np.vdot(s, put))) for s in (shown, shown.conj()))
    if mirrored > 2 * turned:
        raise ConfigError("the pictures show the places mirrored: the machine's x or y axis is reversed")
    yaw = float(np.angle(np.vdot(shown, put)))
    size = float(np.sqrt(np.mean(np.abs(put) ** 2)))
    scale = float(np.vdot(shown, put * np.exp(-1j * yaw)).real / max(np.vdot(shown, shown).real, 1e-9))
    seen = shown * np.exp(1j * yaw)
    rms, unscaled_rms = (float(np.sqrt(np.mean(np.abs(each - put) ** 2))) for each in (scale * seen, seen))
    if not (rms <= _MOST_PICTURED_RMS * size and _PICTURED_SCALE[0] <= scale <= _PICTURED_SCALE[1]):
        found = f"found the ball in the pictures {unscaled_rms:.1f} mm (RMS) from its stated places"
        raise ConfigError(f"{found}, expected at most {_MOST_PICTURED_RMS * size:.1f} mm")
    return yaw


@dataclass(frozen=True, slots=True)
class Stand:
    """The pose of a sensor under a machine; z points upwards in both frames."""

    machine_T_sensor: Rigid
    skin_radius_mm: float

    @property
    def yaw_deg(self) -> float:
        """Yaw of the sensor frame in the machine's, from x towards y."""
        rotation = self.machine_T_sensor.rotation
        return math.degrees(math.atan2(rotation[1, 0], rotation[0, 0]))

    @property
    def indenter_yaw_deg(self) -> float:
        """Yaw in the sensor frame of an indenter aligned with the machine's axes."""
        return -self.yaw_deg

    def head_mm(self, x_mm: float, y_mm: float, depth_mm: float) -> tuple[float, float, float]:
        """Place in the machine's frame, mm, of an indenter's lowest point at (x, y) and a depth as in PRESSES.csv."""
        skin_z_mm = math.sqrt(max(self.skin_radius_mm**2 - x_mm**2 - y_mm**2, 0.0))
        x, y, z = self.machine_T_sensor.apply(np.array((x_mm, y_mm, skin_z_mm - depth_mm))).tolist()
        return x, y, z


def stand(centre_mm: F64, yaw_rad: float, skin_radius_mm: float) -> Stand:
    """The pose from the results of `skin_centre` and `yaw_of`."""
    return Stand(shift(*centre_mm.tolist()) @ turn((0.0, 0.0, yaw_rad)), skin_radius_mm)


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
