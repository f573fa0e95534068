"""Labels of a frame from a robot's poses: how the object has moved relative to the sensor since first touch."""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.capture.robot_place import PoseAt, base_T_sensor
from tacshade_edge.core.calibration.inputs import Sensor
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.types import Frame


class RobotLabels:
    """Labels relative to the pose at first touch. `sensor`: has ``flange_T_sensor``."""

    def __init__(self, sensor: Sensor, pose_at: PoseAt) -> None:
        self._skin_radius_mm = sensor.skin_radius_mm
        self._flange_T_sensor = from_seven(sensor.flange_T_sensor)
        self._pose_at = pose_at
        self._first: Rigid | None = None

    @property
    def knows_first_touch(self) -> bool:
        """Whether the person has confirmed the first touch."""
        return self._first is not None

    def confirm_first_touch(self, frame: Frame) -> None:
        """Keep the pose of a frame in which the skin just touches. Raises ConfigError."""
        self._first = self._base_T_sensor(frame)

    def labels(self, frame: Frame) -> dict[str, float]:
        """Return the labels of `labels_between`; none before the first touch is confirmed. Raises ConfigError."""
        if self._first is None:
            return {}
        return labels_between(self._first, self._base_T_sensor(frame), self._skin_radius_mm)

    def _base_T_sensor(self, frame: Frame) -> Rigid:
        return base_T_sensor(self._pose_at(frame), self._flange_T_sensor)


def labels_between(first: Rigid, now: Rigid, skin_radius_mm: float) -> dict[str, float]:
    """Return depth, tilt, shear and twist of an object that stands still, relative to the first touch.

    With now_T_first = now⁻¹ first, the object's point that was at the skin's tip (0, 0, r) is now at q = now_T_first
    (0, 0, r): depth is r - q_z, shear (q_x, q_y). The object has turned by the rotation of now_T_first, which is
    R_y(tilt_y) R_x(tilt_x) R_z(twist).

    `first`, `now`: ``base_T_sensor``. `skin_radius_mm`: r.
    """
    moved = now.inverse() @ first
    x, y, z = moved.apply(np.array((0.0, 0.0, skin_radius_mm))).tolist()
    turned = moved.rotation
    return {
        "depth_mm": skin_radius_mm - z,
        "tilt_x_deg": -math.degrees(math.asin(max(-1.0, min(1.0, turned[1, 2])))),
        "tilt_y_deg": math.degrees(math.atan2(turned[0, 2], turned[2, 2])),
        "shear_x_mm": x,
        "shear_y_mm": y,
        "twist_deg": math.degrees(math.atan2(turned[1, 0], turned[1, 1])),
    }
