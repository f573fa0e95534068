"""An object pressed at a position: the convention of every press in this package."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from tacshade_edge.simulator.objects import Shape
from tacshade_edge.types import F64


@dataclass(frozen=True, slots=True)
class Press:
    """An indenter that moved along -z and then along the skin.

    x, y is where the object's origin (without a tilt, its lowest point) is after the drag, as in the image. `depth_mm`
    is z of the undeformed skin there minus z of the lowest point, negative above the skin; it is not the travel from
    first touch: a wide object off the axis touches earlier, nearer to the apex. The shape is enlarged by `scale` about
    its lowest point, turned about its z axis from x towards y, and tilted about the sensor's x, then y axis. The drag
    says how far it moved after it touched, the twist how far it turned about z through (x, y), from x towards y.
    """

    shape: Shape
    x_mm: float = 0.0
    y_mm: float = 0.0
    depth_mm: float = 3.0
    rotation_deg: float = 0.0
    scale: float = 1.0
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0
    drag_x_mm: float = 0.0
    drag_y_mm: float = 0.0
    twist_deg: float = 0.0

    def __post_init__(self) -> None:
        """Raise ValueError for values that are not finite, or a scale of 0 or less."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, int | float) and not math.isfinite(value):
                raise ValueError(f"{field.name} is {value}, expected a finite number")
        if self.scale <= 0:
            raise ValueError(f"scale is {self.scale}, expected a positive number")

    def lowest_z_mm(self, skin_radius_mm: float) -> float:
        """The z of the lowest point in the sensor frame, in mm. Raises ValueError if (x, y) is not over the skin."""
        beside = skin_radius_mm**2 - self.x_mm**2 - self.y_mm**2
        if beside <= 0:
            raise ValueError(
                f"a press at x {self.x_mm}, y {self.y_mm} mm is not over the skin of radius {skin_radius_mm} mm"
            )
        return math.sqrt(beside) - self.depth_mm

    @property
    def is_tilted(self) -> bool:
        """Whether the object's z axis differs from the sensor's."""
        return bool(self.tilt_x_deg or self.tilt_y_deg)

    @property
    def is_dragged(self) -> bool:
        """Whether the object moved along the skin after it touched."""
        return bool(self.drag_x_mm or self.drag_y_mm or self.twist_deg)

    def tilt(self) -> F64:
        """Rotation matrix (3, 3) of the tilt about x, then y."""
        b, c = math.radians(self.tilt_x_deg), math.radians(self.tilt_y_deg)
        about_x = np.array(((1, 0, 0), (0, math.cos(b), -math.sin(b)), (0, math.sin(b), math.cos(b))))
        about_y = np.array(((math.cos(c), 0, math.sin(c)), (0, 1, 0), (-math.sin(c), 0, math.cos(c))))
        return np.asarray(about_y @ about_x)

    def distance_mm(self, skin_radius_mm: float, points_mm: F64) -> F64:
        """Signed distance (N,) in mm of points (N, 3) in the sensor frame; of their dtype."""
        a = math.radians(self.rotation_deg)
        c, s = math.cos(a) / self.scale, math.sin(a) / self.scale
        x, y = points_mm[:, 0] - self.x_mm, points_mm[:, 1] - self.y_mm
        z = points_mm[:, 2] - self.origin_z_mm(skin_radius_mm)
        if self.is_tilted:
            x, y, z = (np.stack((x, y, z), axis=1) @ self.tilt().astype(points_mm.dtype)).T
        return self.shape.sdf(np.stack((c * x + s * y, c * y - s * x, z / self.scale), axis=1)) * self.scale

    def origin_z_mm(self, skin_radius_mm: float) -> float:
        """The z of the object's origin in the sensor frame, in mm. Raises ValueError if (x, y) is not over the skin."""
        lowest = self.lowest_z_mm(skin_radius_mm)
        if not self.is_tilted:
            return lowest
        return lowest - self.scale * _lowest_mm(self.shape, self.rotation_deg, self.tilt_x_deg, self.tilt_y_deg)

    def before_drag(self, x_y_mm: F64) -> F64:
        """Positions (..., 2) in mm, when the object touched, of its points that are now at `x_y_mm`."""
        a = math.radians(self.twist_deg)
        back = np.array(((math.cos(a), -math.sin(a)), (math.sin(a), math.cos(a))))  # its transpose turns forward
        origin = np.array((self.x_mm, self.y_mm))
        return np.asarray((x_y_mm - origin) @ back + origin - np.array((self.drag_x_mm, self.drag_y_mm)))


@functools.lru_cache(maxsize=256)
def _lowest_mm(shape: Shape, rotation_deg: float, tilt_x_deg: float, tilt_y_deg: float) -> float:
    """The z in mm of a tilted shape's lowest point over its origin; within 2 µm for shapes up to 40 mm wide."""
    upright = Press(shape, rotation_deg=rotation_deg)
    tilt = Press(shape, tilt_x_deg=tilt_x_deg, tilt_y_deg=tilt_y_deg).tilt()
    up = np.array((0.0, 0.0, upright.lowest_z_mm(100.0)))
    centre, half, lowest = np.zeros(2), 24.0, 0.0
    for _ in range(4):
        axis = np.linspace(-half, half, 61)
        x, y = (v.ravel() + c for v, c in zip(np.meshgrid(axis, axis), centre, strict=True))
        z = np.full(x.shape, -60.0)
        for _ in range(80):
            low = z < float(z.min()) + half  # only points that may still be the lowest
            d = upright.distance_mm(100.0, np.stack((x[low], y[low], z[low]), axis=1) @ tilt + up)
            z[low] += np.maximum(d, 0)
            if float(d.max()) < 1e-4:
                break
            z[low & (z > 60)] = 60.0
        best = int(np.argmin(z))
        centre, lowest, half = np.array((x[best], y[best])), float(z[best]), half / 20
    return lowest


def distances_mm(presses: Sequence[Press], skin_radius_mm: float, points_mm: F64) -> F64:
    """Signed distances (presses, N), negative inside, from points (N, 3) to each pressed object (at least one)."""
    return np.stack([press.distance_mm(skin_radius_mm, points_mm) for press in presses])


def distance_mm(presses: Sequence[Press], skin_radius_mm: float, points_mm: F64) -> F64:
    """Signed distance (N,) in mm to the nearest pressed object: the least of `distances_mm`."""
    return np.asarray(distances_mm(presses, skin_radius_mm, points_mm).min(axis=0))
