"""Select the points of one press for a map, with a confidence for each,
once the pressing robot has come to rest.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from tacshade_edge.rigid import Rigid
from tacshade_edge.sensor.contact.objects import bounding_box
from tacshade_edge.sensor.geometry.disc import Grid, disc_rays, radius_squared, skin_points
from tacshade_edge.types import F32, F64, Geometry, HeightMap, frozen

REST_NS = 300_000_000
STEADY_MM = 0.06
# Of the depth, because a deep contact trembles more.
_STEADY_FRACTION = 0.03
# Confidence grows to 1 over this distance into the contact:
# skin beyond it is skirt, off the object.
OUTLINE_MM = 0.8
# Outer part of the disc's radius: the camera looks along the skin, and confidence falls.
RIM_FRACTION = 0.2
MIN_CONFIDENCE = 0.05
# Of cells, which are divided or subsampled, so that a map of 0.25 mm has no holes between them.
SPACING_MM = 0.3
# Of a point's lateral error, which times the slope is an error in height, to its height error.
_LATERAL_RATIO = 5.0


class RestDetector:
    """Fires once in each contact, after its depth was steady for `REST_NS`."""

    def __init__(self) -> None:
        self._fired = False
        self._since_ns = 0
        self._min_mm = self._max_mm = 0.0

    def suppress(self) -> None:
        """Count the present contact as fired, so that it does not fire again."""
        self._fired = True

    def update(self, t_ns: int, contact: bool, depth_mm: float) -> bool:
        """Take the next frame (an invalid one ends a contact);
        whether the contact has just come to rest.
        """
        if not contact:
            self._fired, self._since_ns = False, 0
            return False
        min_mm, max_mm = min(self._min_mm, depth_mm), max(self._max_mm, depth_mm)
        if self._since_ns == 0 or max_mm - min_mm > STEADY_MM + _STEADY_FRACTION * max_mm:
            self._since_ns, self._min_mm, self._max_mm = t_ns, depth_mm, depth_mm
            return False
        self._min_mm, self._max_mm = min_mm, max_mm
        if self._fired or t_ns - self._since_ns < REST_NS:
            return False
        self._fired = True
        return True


@frozen
class PressPoints:
    """The contact's skin points (N, 3) of one press in the sensor frame, the skin's outward unit
    normals, and a confidence above 0, up to 1.
    """

    points_mm: F32
    normals: F32
    confidence: F32


NO_POINTS = PressPoints(
    np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
)


def press_points(height: HeightMap, geometry: Geometry) -> PressPoints:
    """Select the contact's skin points, row by row,
    from a map made with a calibration of this geometry.
    """
    box = bounding_box(height.contact)
    if box is None:
        return NO_POINTS
    cell_mm = height.step_px * geometry.mm_per_px
    divisor, stride = math.ceil(cell_mm / SPACING_MM), max(1, int(SPACING_MM / cell_mm))
    step_px = height.step_px * stride / divisor
    h = np.ascontiguousarray(height.height_mm[box][::stride, ::stride])
    if divisor > 1:  # bilinear between the cells' middles, constant beyond them
        h = cv2.resize(h, None, fx=divisor, fy=divisor, interpolation=cv2.INTER_LINEAR)
    cells = height.contact[box][::stride, ::stride]
    contact = np.ascontiguousarray(cells.repeat(divisor, axis=0).repeat(divisor, axis=1))
    # A single row of cells has no gradient across it, and so no normals.
    if min(h.shape) <= 1:
        return NO_POINTS
    # The first part of a divided cell lies before the cell's middle.
    row0, col0 = (
        first + span.start * height.step_px - height.step_px * (divisor - 1) / (2 * divisor)
        for first, span in zip((height.row0, height.col0), box, strict=True)
    )
    grid = Grid(h.shape[0], h.shape[1], row0, col0, step_px)
    points = skin_points(h, disc_rays(grid, geometry), geometry)
    across = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normals = np.asarray(across / np.linalg.norm(across, axis=2, keepdims=True), np.float32)
    inside_mm = cv2.distanceTransform(contact.view(np.uint8), cv2.DIST_L2, 5) * (
        step_px * geometry.mm_per_px
    )
    to_rim = (1 - np.sqrt(radius_squared(grid, geometry.disc))) / RIM_FRACTION
    # Two reasons for doubt, of which the greater counts: near the outline the skin lifts off the
    # object, near the rim the camera looks along it.
    confidence = np.clip(np.minimum(inside_mm / OUTLINE_MM, to_rim), MIN_CONFIDENCE, 1)
    # Drops points with a neighbour outside the disc.
    contact = contact & np.isfinite(normals).all(axis=2)
    return PressPoints(points[contact], normals[contact], confidence[contact].astype(np.float32))


def height_weight(press: PressPoints, base_T_sensor: Rigid) -> F64:
    """Weight of each point's z in the base frame: its confidence, reduced by the slope."""
    cosine = np.abs(press.normals @ base_T_sensor.rotation[2])
    slope2 = (1 - cosine**2) / np.maximum(cosine, 1e-3) ** 2
    return np.asarray(
        press.confidence / (1 + _LATERAL_RATIO**2 * np.maximum(slope2, 0)), np.float64
    )
