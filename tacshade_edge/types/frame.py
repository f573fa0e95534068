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
    """One image of the sensor's camera.

    Attributes
    ----------
    seq : int
        Counts the frames of this source from 0; a gap marks frames that the source knows it lost.
    t_ns : int
        Capture time, CLOCK_MONOTONIC.
    wall_ns : int
        The same instant as Unix time, for metadata only.
    image : uint8 (H, W) grey or (H, W, 3) BGR
    pose : Pose or None
        ``base_T_flange`` at `t_ns`, if known.
    pose_error_us : int
        Greatest difference between `t_ns` and the pose's time, µs; 0 without a pose.
    """

    seq: int
    t_ns: int
    wall_ns: int
    image: U8
    pose: Pose | None = None
    pose_error_us: int = 0
