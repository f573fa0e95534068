"""What a robot's poses show of a press: place and depth on a fixed indenter,
or labels relative to first touch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from tacshade_edge.calibration.files.press_table import BALL
from tacshade_edge.calibration.indenters import skin_z_mm
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.calibration.press_machine import FixedIndenter, TouchPoint, fixed_indenter
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid, from_seven, of_pose
from tacshade_edge.types import Frame, Pose

PoseAt = Callable[[Frame], Pose | str]
"""``pose_at(frame)``: ``base_T_flange`` when the frame was taken, or why it is unknown."""

# Beyond this turn, a press by any indenter other than a ball would need its tilt columns.
_TURN_MOST_DEG = 0.5

Name = tuple[str, str]
"""Indenter and radius, as in PRESSES.csv."""


def _base_T_sensor(sensor: StatedSensor, pose: Pose | str) -> Rigid:
    """The pose of a sensor that a robot holds.

    Raises ConfigError with the reason if it is unknown.
    """
    if isinstance(pose, str):
        raise ConfigError(pose)
    return of_pose(pose) @ from_seven(sensor.flange_T_sensor)


class RobotPlaces:
    """Places of presses: one typed press locates an indenter,
    the robot's poses give the place of all others.
    """

    def __init__(self, sensor: StatedSensor, pose_at: PoseAt) -> None:
        self._sensor, self._pose_at = sensor, pose_at
        self._fixed: dict[Name, FixedIndenter] = {}

    def known(self, name: Name) -> bool:
        """Whether this indenter's place is known from a typed press."""
        return name in self._fixed

    def learn(self, columns: Sequence[str], frame: Frame) -> str:
        """Learn an indenter's place from a typed press;
        return why that fails, or an empty string.
        """
        indenter, radius_mm, depth_mm, x_mm, y_mm, *more = columns
        # A tilted or dragged press does not show where the indenter stands.
        if not x_mm or any(more):
            return ""
        try:
            held = _base_T_sensor(self._sensor, self._pose_at(frame))
        except ConfigError as error:
            return str(error)
        stated = TouchPoint(float(x_mm), float(y_mm), float(depth_mm))
        # A ball is located by its centre, which no turn of the sensor moves; anything else by its
        # lowest point.
        ball_radius_mm = float(radius_mm) if indenter == BALL else 0.0
        self._fixed[indenter, radius_mm] = fixed_indenter(
            held, stated, ball_radius_mm, self._sensor.skin_radius_mm
        )
        return ""

    def columns(self, name: Name, frame: Frame) -> tuple[str, ...]:
        """Return the columns of PRESSES.csv for a press of a known indenter. Raises ConfigError."""
        fixed, held = self._fixed[name], _base_T_sensor(self._sensor, self._pose_at(frame))
        if name[0] != BALL and (turned_deg := fixed.turned_deg(held)) > _TURN_MOST_DEG:
            expected = (
                f"expected at most {_TURN_MOST_DEG} degrees for any indenter other than a ball"
            )
            raise ConfigError(
                f"found a sensor rotation of {turned_deg:.1f} degrees since the press whose place "
                f"you typed, {expected}"
            )
        try:
            touch = fixed.touch(held, self._sensor.skin_radius_mm)
        except ValueError as error:
            raise ConfigError(f"the robot's pose: {error}") from None
        return *name, f"{touch.depth_mm:.3f}", f"{touch.x_mm:.3f}", f"{touch.y_mm:.3f}"


class RobotLabels:
    """Labels relative to the pose at first touch."""

    def __init__(self, sensor: StatedSensor, pose_at: PoseAt) -> None:
        self._sensor, self._pose_at = sensor, pose_at
        self._first: Rigid | None = None

    @property
    def knows_first_touch(self) -> bool:
        """Whether the person has confirmed the first touch."""
        return self._first is not None

    def confirm_first_touch(self, frame: Frame) -> None:
        """Keep the pose of a frame in which the skin just touches. Raises ConfigError."""
        self._first = _base_T_sensor(self._sensor, self._pose_at(frame))

    def labels(self, frame: Frame) -> dict[str, float]:
        """Return the labels of `labels_between`; none before the first touch is confirmed.

        Raises ConfigError.
        """
        if self._first is None:
            return {}
        return labels_between(
            self._first,
            _base_T_sensor(self._sensor, self._pose_at(frame)),
            self._sensor.skin_radius_mm,
        )


def labels_between(first: Rigid, now: Rigid, skin_radius_mm: float) -> dict[str, float]:
    """Return depth, tilt, shear and twist of an object that stands still,
    relative to the first touch.

    With now_T_first = now⁻¹ first, the object's point that was at the skin's tip (0, 0, r) is now
    at q = now_T_first (0, 0, r): depth is r - q_z, shear (q_x, q_y). The object has turned by the
    rotation of now_T_first, which is R_y(tilt_y) R_x(tilt_x) R_z(twist). The tip of a pad (r
    infinite) is (0, 0, 0).

    `first`, `now`: ``base_T_sensor``. `skin_radius_mm`: r.
    """
    moved, apex_mm = now.inverse() @ first, skin_z_mm(skin_radius_mm, 0.0, 0.0)
    x, y, z = moved.apply(np.array((0.0, 0.0, apex_mm))).tolist()
    turned = moved.rotation
    return {
        "depth_mm": apex_mm - z,
        # Rounding may carry a sine beyond 1.
        "tilt_x_deg": -math.degrees(math.asin(max(-1.0, min(1.0, turned[1, 2])))),
        "tilt_y_deg": math.degrees(math.atan2(turned[0, 2], turned[2, 2])),
        "shear_x_mm": x,
        "shear_y_mm": y,
        "twist_deg": math.degrees(math.atan2(turned[1, 0], turned[1, 1])),
    }
