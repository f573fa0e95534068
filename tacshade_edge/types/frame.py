"""One image from a camera, and where the robot held the camera."""

from __future__ import annotations

from dataclasses import dataclass

from .arrays import U8, frozen

IDENTITY_POSE = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Pose:
    """``base_T_flange`` at a time: translation in mm and the unit quaternion w, x, y, z."""

    t_ns: int
    x_mm: float
    y_mm: float
    z_mm: float
    qw: float
    qx: float
    qy: float
    qz: float


@frozen
class Frame:
    """One image of the sensor's camera, uint8 (H, W) grey or (H, W, 3) BGR."""

    seq: int  # counts the frames of this source from 0; a gap marks frames that the source knows it lost
    t_ns: int  # capture time, CLOCK_MONOTONIC
    wall_ns: int  # the same instant as Unix time, for metadata only
    image: U8
    pose: Pose | None = None  # ``base_T_flange`` at `t_ns`, if known
    pose_error_us: int = 0  # greatest difference between `t_ns` and the pose's time; 0 without a pose
