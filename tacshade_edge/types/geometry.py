"""Skin, camera and visible circle."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Disc:
    """The visible circle in the image; pixel centres are integers."""

    row_c: float
    col_c: float
    radius_px: float


@dataclass(frozen=True, slots=True)
class Geometry:
    """Skin, camera and visible circle: everything needed to turn a pixel into a ray.

    Attributes
    ----------
    skin_radius_mm : float
        r, the radius of the undeformed skin, centred at O.
    camera_distance_mm : float or None
        d: the lens is at (0, 0, -d). None means the paper's orthographic camera.
    visible_half_angle_deg : float
        θ of the visible circle, measured at O from +z.
    disc : Disc
    """

    skin_radius_mm: float
    camera_distance_mm: float | None
    visible_half_angle_deg: float
    disc: Disc

    @property
    def f_px(self) -> float:
        """Focal length of the pinhole in px; 0 for the orthographic camera."""
        if self.camera_distance_mm is None:
            return 0.0
        theta = math.radians(self.visible_half_angle_deg)
        r = self.skin_radius_mm
        return self.disc.radius_px * (r * math.cos(theta) + self.camera_distance_mm) / (r * math.sin(theta))

    @property
    def mm_per_px(self) -> float:
        """Size of a pixel in the plane of the visible circle (r sinθ / R_px)."""
        theta = math.radians(self.visible_half_angle_deg)
        return self.skin_radius_mm * math.sin(theta) / self.disc.radius_px
