"""An object at a place: the convention of every press in this package."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.simulator.objects import Shape
from tacshade_edge.types import F64


@dataclass(frozen=True, slots=True)
class Press:
    """An indenter that came along -z.

    Attributes
    ----------
    shape : Shape
    x_mm, y_mm : float
        Where its lowest point is.
    depth_mm : float
        The undeformed skin's z at (x, y) less the z of the lowest point. It is not travel from first touch: a wide
        object off the axis touches earlier, nearer to the apex. Negative: above the skin there.
    rotation_deg : float
        About its own z axis, from x towards y.
    scale : float
        Enlarges the shape about its lowest point.
    """

    shape: Shape
    x_mm: float = 0.0
    y_mm: float = 0.0
    depth_mm: float = 3.0
    rotation_deg: float = 0.0
    scale: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what is not a number."""
        for name in ("x_mm", "y_mm", "depth_mm", "rotation_deg", "scale"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} is {getattr(self, name)}, expected a finite number")
        if self.scale <= 0:
            raise ValueError(f"scale is {self.scale}, expected a positive number")

    def lowest_z_mm(self, skin_radius_mm: float) -> float:
        """Find z of the lowest point in the sensor frame. Raises ValueError when (x, y) is not over the skin."""
        beside = skin_radius_mm**2 - self.x_mm**2 - self.y_mm**2
        if beside <= 0:
            raise ValueError(
                f"a press at x {self.x_mm}, y {self.y_mm} mm is not over the skin of radius {skin_radius_mm} mm"
            )
        return math.sqrt(beside) - self.depth_mm


def distance_mm(presses: Sequence[Press], skin_radius_mm: float, points_mm: F64) -> F64:
    """Signed distance to the nearest pressed object.

    Parameters
    ----------
    presses : sequence of Press
        At least one.
    skin_radius_mm : float
    points_mm : float (N, 3)
        In the sensor frame.

    Returns
    -------
    float (N,)
        mm, negative inside; of the points' dtype.
    """
    nearest: F64 | None = None
    for press in presses:
        a = math.radians(press.rotation_deg)
        c, s = math.cos(a) / press.scale, math.sin(a) / press.scale
        x, y = points_mm[:, 0] - press.x_mm, points_mm[:, 1] - press.y_mm
        z = (points_mm[:, 2] - press.lowest_z_mm(skin_radius_mm)) / press.scale
        d = press.shape.sdf(np.stack((c * x + s * y, c * y - s * x, z), axis=1)) * press.scale
        nearest = d if nearest is None else np.minimum(nearest, d)
    assert nearest is not None
    return nearest
