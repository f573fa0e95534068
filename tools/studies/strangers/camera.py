"""Cameras that no simulated sensor of the training has:
a distorting fisheye lens and a tilted pinhole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tacshade_edge.types import F64

HEIGHT_PX, WIDTH_PX = 480, 640


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera below the skin's middle O that looks along +z, tilted about x, then y.

    A point at an angle ψ from the axis lies `focal_px` (ψ + `distortion` ψ³) from (`row_c`,
    `col_c`) through a fisheye lens, and `focal_px` tan ψ through a pinhole.
    """

    lens: Literal["fisheye", "pinhole"]
    distance_mm: float  # from O
    focal_px: float
    row_c: float
    col_c: float
    distortion: float = 0.0
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0

    @property
    def place_mm(self) -> F64:
        """Where it is, (3,)."""
        return np.array((0.0, 0.0, -self.distance_mm))

    def project(self, points_mm: F64) -> F64:
        """Image coordinates (..., 2), col and row, of points (..., 3)."""
        seen = (points_mm - self.place_mm) @ self._turned().T
        across = np.hypot(seen[..., 0], seen[..., 1])
        angle = np.arctan2(across, seen[..., 2])
        if self.lens == "fisheye":
            far = self.focal_px * (angle + self.distortion * angle**3)
        else:
            far = self.focal_px * np.tan(angle)
        scale = far / np.maximum(across, 1e-9)
        return np.stack(
            (self.col_c + scale * seen[..., 0], self.row_c + scale * seen[..., 1]), axis=-1
        )

    def _turned(self) -> F64:
        a, b = math.radians(self.tilt_x_deg), math.radians(self.tilt_y_deg)
        about_x = np.array(
            ((1, 0, 0), (0, math.cos(a), -math.sin(a)), (0, math.sin(a), math.cos(a)))
        )
        about_y = np.array(
            ((math.cos(b), 0, math.sin(b)), (0, 1, 0), (-math.sin(b), 0, math.cos(b)))
        )
        return np.asarray(about_y @ about_x)
