"""Place and depth of a press, from the poses of a robot that presses the sensor onto a fixed indenter."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tacshade_edge.core.calibration.inputs import Sensor
from tacshade_edge.core.calibration.machine import FixedIndenter, Touch, fixed_indenter
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid, from_seven, of_pose
from tacshade_edge.storage.tables.presses import BALL
from tacshade_edge.types import Frame, Pose

PoseAt = Callable[[Frame], Pose | str]
"""``pose_at(frame)``: ``base_T_flange`` when the frame was taken, or why it is unknown."""

# Beyond this turn, a press by any indenter other than a ball would need its tilt columns.
_TURN_MOST_DEG = 0.5

Name = tuple[str, str]
"""Indenter and radius, as in PRESSES.csv."""


class RobotPlaces:
    """Places of presses: one typed press locates an indenter, the robot's poses give the place of all others. `sensor`:
    has ``flange_T_sensor``.
    """

    def __init__(self, sensor: Sensor, pose_at: PoseAt) -> None:
        self._skin_radius_mm = sensor.skin_radius_mm
        self._flange_T_sensor = from_seven(sensor.flange_T_sensor)
        self._pose_at = pose_at
        self._fixed: dict[Name, FixedIndenter] = {}

    def known(self, name: Name) -> bool:
        """Whether this indenter's place is known from a typed press."""
        return name in self._fixed

    def learn(self, columns: Sequence[str], frame: Frame) -> str:
        """Learn an indenter's place from a typed press; return why that fails, or an empty string."""
        indenter, radius_mm, depth_mm, x_mm, y_mm, *more = columns
        if not x_mm or any(more):
            return ""
        try:
            held = self._base_T_sensor(frame)
        except ConfigError as error:
            return str(error)
        stated = Touch(float(x_mm), float(y_mm), float(depth_mm))
        ball_radius_mm = float(radius_mm) if indenter == BALL else 0.0
        self._fixed[indenter, radius_mm] = fixed_indenter(held, stated, ball_radius_mm, self._skin_radius_mm)
        return ""

    def columns(self, name: Name, frame: Frame) -> tuple[str, ...]:
        """Return the columns of PRESSES.csv for a press of a known indenter. Raises ConfigError."""
        fixed, held = self._fixed[name], self._base_T_sensor(frame)
        if name[0] != BALL and (turned_deg := fixed.turned_deg(held)) > _TURN_MOST_DEG:
            expected = f"expected at most {_TURN_MOST_DEG} degrees for any indenter other than a ball"
            raise ConfigError(
                f"found a sensor rotation of {turned_deg:.1f} degrees since the press whose place you typed, {expected}"
            )
        try:
            touch = fixed.touch(held, self._skin_radius_mm)
        except ValueError as error:
            raise ConfigError(f"the robot's pose: {error}") from None
        return *name, f"{touch.depth_mm:.3f}", f"{touch.x_mm:.3f}", f"{touch.y_mm:.3f}"

    def _base_T_sensor(self, frame: Frame) -> Rigid:
        return base_T_sensor(self._pose_at(frame), self._flange_T_sensor)


def base_T_sensor(pose: Pose | str, flange_T_sensor: Rigid) -> Rigid:
    """Return the sensor's pose in the robot's base frame. Raises ConfigError with the reason if it is unknown."""
    if isinstance(pose, str):
        raise ConfigError(pose)
    return of_pose(pose) @ flange_T_sensor
