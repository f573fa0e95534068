"""Arrays by element and records of read-only arrays; a camera's image and its pose;
skin, camera and visible circle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeVar, dataclass_transform

import numpy as np
import numpy.typing as npt

U8 = npt.NDArray[np.uint8]
U16 = npt.NDArray[np.uint16]
I32 = npt.NDArray[np.int32]
I64 = npt.NDArray[np.int64]
F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]


Record = TypeVar("Record")


@dataclass_transform(frozen_default=True, eq_default=False)
def frozen(cls: type[Record]) -> type[Record]:
    """Make a frozen dataclass with slots, equal only to itself,
    whose arrays are read-only views.
    """
    names = tuple(cls.__annotations__)

    def freeze_arrays(self: Record) -> None:
        # Several records are made for every frame, most of them of read-only arrays.
        for name in names:
            value = getattr(self, name)
            if isinstance(value, np.ndarray) and value.flags.writeable:
                freeze(self, name)

    cls.__post_init__ = freeze_arrays  # type: ignore[attr-defined]
    return dataclass(frozen=True, slots=True, eq=False)(cls)


def freeze(value: object, *names: str) -> None:
    """Replace the named array attributes by read-only views."""
    for name in names:
        view = getattr(value, name).view()
        view.setflags(write=False)
        object.__setattr__(value, name, view)


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

    # Counts the frames of this source from 0; a gap marks frames that the source knows it lost.
    seq: int
    t_ns: int  # capture time, CLOCK_MONOTONIC
    wall_ns: int  # the same instant as Unix time, for metadata only
    image: U8
    pose: Pose | None = None  # ``base_T_flange`` at `t_ns`, if known
    # Greatest difference between `t_ns` and the pose's time; 0 without a pose.
    pose_error_us: int = 0


@dataclass(frozen=True, slots=True)
class Disc:
    """The visible circle in the image; pixel centres are integers."""

    row_c: float
    col_c: float
    radius_px: float


Skin = Literal["dome", "pad"]
# The half angle of a dome that shows as much as a pad does, degrees;
# below that of any dome that networks learnt from.
_LEAST_HALF_ANGLE_DEG = 40.0


@dataclass(frozen=True, slots=True)
class Geometry:
    """Skin, camera and visible circle.

    `skin_radius_mm` is r of the undeformed dome, centred at O; `camera_distance_mm` d, for a lens
    at (0, 0, -d) (None: the paper's orthographic camera); `visible_half_angle_deg` θ of the visible
    circle, at O from +z. A pad is flat (r infinite, θ = 0): its skin at rest is the plane z = 0, O
    is the middle of its visible circle, and `pad_radius_mm` the circle's radius.
    """

    skin_radius_mm: float
    camera_distance_mm: float | None
    visible_half_angle_deg: float
    disc: Disc
    pad_radius_mm: float | None = None

    @property
    def skin(self) -> Skin:
        """The form of the undeformed skin."""
        return "dome" if self.pad_radius_mm is None else "pad"

    @property
    def visible_radius_mm(self) -> float:
        """Radius of the visible circle on the undeformed skin,
        in a plane across the axis (a dome's: r sinθ).
        """
        if self.pad_radius_mm is not None:
            return self.pad_radius_mm
        return self.skin_radius_mm * math.sin(math.radians(self.visible_half_angle_deg))

    @property
    def size_mm(self) -> float:
        """The length with which sizes of presses and tolerances scale: a dome's radius; for a skin
        that is flat, or flatter than the networks know, the radius of a dome with the same visible
        circle.
        """
        least = math.sin(math.radians(_LEAST_HALF_ANGLE_DEG))
        return min(self.skin_radius_mm, self.visible_radius_mm / least)

    @property
    def apex_z_mm(self) -> float:
        """The z of the middle of the undeformed skin: r for a dome, 0 for a pad."""
        return self.skin_radius_mm if self.pad_radius_mm is None else 0.0

    @property
    def height_max_mm(self) -> float:
        """The greatest h that a skin can have: a dome's reaches O, a pad's the lens,
        or its size without one.
        """
        if self.pad_radius_mm is None:
            return self.skin_radius_mm
        return self.camera_distance_mm or self.size_mm

    @property
    def f_px(self) -> float:
        """Focal length of the pinhole in px; 0 for the orthographic camera."""
        if self.camera_distance_mm is None:
            return 0.0
        if self.pad_radius_mm is not None:
            return self.disc.radius_px * self.camera_distance_mm / self.pad_radius_mm
        theta = math.radians(self.visible_half_angle_deg)
        r = self.skin_radius_mm
        return (
            self.disc.radius_px
            * (r * math.cos(theta) + self.camera_distance_mm)
            / (r * math.sin(theta))
        )

    @property
    def mm_per_px(self) -> float:
        """Size of a pixel in the plane of the visible circle (a dome's: r sinθ / R_px)."""
        return self.visible_radius_mm / self.disc.radius_px
