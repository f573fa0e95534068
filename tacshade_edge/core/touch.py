"""Which points of one press go into a map, and how far each is trusted."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.core.clusters import bounding_box
from tacshade_edge.core.disc import Grid, disc_rays, radius_squared
from tacshade_edge.core.skin import skin_points
from tacshade_edge.types import F32, Geometry, HeightMap, freeze

# The outline is found within a cell or two, and skin beyond it is skirt, which lies off the object: the outermost cells
# are left out, and trust grows to 1 over this way into the contact (measured: docs/stitching.md).
TRUSTED_INSIDE_MM = 0.8
_OUTERMOST_CELLS = 1.1  # the distance transform's 1 is a cell at the outline
# Over this outer part of the disc's radius the camera looks along the skin, and trust falls to `LEAST_TRUST`.
EDGE_PART = 0.2
LEAST_TRUST = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """What one press touched.

    Attributes
    ----------
    points_mm : float32 (N, 3)
        Sensor frame.
    trust : float32 (N,)
        Over 0, up to 1.
    """

    points_mm: F32
    trust: F32

    def __post_init__(self) -> None:
        freeze(self, "points_mm", "trust")


def touch_points(height: HeightMap, geometry: Geometry) -> Touch:
    """The contact's skin points within its outline, row by row.

    Parameters
    ----------
    height : HeightMap
    geometry : Geometry
        Of the calibration that made it.
    """
    here = bounding_box(height.contact)
    if here is None:
        return Touch(np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    rows, cols = here
    h, touched = np.ascontiguousarray(height.height_mm[here]), np.ascontiguousarray(height.contact[here])
    row0, col0 = height.row0 + rows.start * height.step_px, height.col0 + cols.start * height.step_px
    grid = Grid(*h.shape, row0, col0, height.step_px)
    points, _ = skin_points(h, disc_rays(grid, geometry), geometry)
    inside = cv2.distanceTransform(touched.view(np.uint8), cv2.DIST_L2, 5)
    inside_mm = inside * (height.step_px * geometry.mm_per_px)
    to_edge = (1 - np.sqrt(radius_squared(grid, geometry.disc))) / EDGE_PART
    trust = np.clip(np.minimum(inside_mm / TRUSTED_INSIDE_MM, to_edge), LEAST_TRUST, 1)
    touched = (inside > _OUTERMOST_CELLS) & np.isfinite(h)
    return Touch(points[touched], trust[touched].astype(np.float32))
