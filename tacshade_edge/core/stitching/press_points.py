"""Which points of one press go into a map, and how far each is trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.core.contact.objects import bounding_box
from tacshade_edge.core.geometry.back_projection import skin_points
from tacshade_edge.core.geometry.disc import Grid, disc_rays, radius_squared
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F32, F64, Geometry, HeightMap, freeze

# The outline is found within a cell or two, and skin beyond it is skirt, which lies off the object: trust grows to 1
# over this way into the contact.
TRUSTED_INSIDE_MM = 0.8
# Over this outer part of the disc's radius the camera looks along the skin, and trust falls to `LEAST_TRUST`.
EDGE_PART = 0.2
LEAST_TRUST = 0.05
# Cells farther apart on the skin are divided, so that a map of 0.25 mm has no holes between them; of nearer ones some
# are taken.
SPACING_MM = 0.3
# A place that is found so far beside its own is off in height by that times the slope: which of the two errors counts.
_BESIDE_PER_HEIGHT = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """What one press touched, in the sensor frame.

    Attributes
    ----------
    points_mm : float32 (N, 3)
    normals : float32 (N, 3)
        Of the skin there, unit length, outwards.
    trust : float32 (N,)
        Over 0, up to 1.
    """

    points_mm: F32
    normals: F32
    trust: F32

    def __post_init__(self) -> None:
        freeze(self, "points_mm", "normals", "trust")


NOTHING = Touch(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32))


def touch_points(height: HeightMap, geometry: Geometry) -> Touch:
    """The contact's skin points, row by row.

    Parameters
    ----------
    height : HeightMap
    geometry : Geometry
        Of the calibration that made it.
    """
    here = bounding_box(height.contact)
    if here is None:
        return NOTHING
    cell_mm = height.step_px * geometry.mm_per_px
    by, every = math.ceil(cell_mm / SPACING_MM), max(1, int(SPACING_MM / cell_mm))
    step_px = height.step_px * every / by
    h = _divided(height.height_mm[here][::every, ::every], by)
    cells = height.contact[here][::every, ::every]
    touched = np.ascontiguousarray(cells.repeat(by, axis=0).repeat(by, axis=1))
    if min(h.shape) < 2:
        return NOTHING
    # The first of the parts of a cell lies before its middle.
    row0, col0 = (
        first + span.start * height.step_px - height.step_px * (by - 1) / (2 * by)
        for first, span in zip((height.row0, height.col0), here, strict=True)
    )
    grid = Grid(h.shape[0], h.shape[1], row0, col0, step_px)
    points = skin_points(h, disc_rays(grid, geometry), geometry)
    normals = _normals(points)
    inside_mm = cv2.distanceTransform(touched.view(np.uint8), cv2.DIST_L2, 5) * (step_px * geometry.mm_per_px)
    to_edge = (1 - np.sqrt(radius_squared(grid, geometry.disc))) / EDGE_PART
    trust = np.clip(np.minimum(inside_mm / TRUSTED_INSIDE_MM, to_edge), LEAST_TRUST, 1)
    touched = touched & np.isfinite(normals).all(axis=2)  # not where a neighbour is outside the disc
    return Touch(points[touched], normals[touched], trust[touched].astype(np.float32))


def height_weight(touch: Touch, base_T_sensor: Rigid) -> F64:
    """How far each point's z in the base frame is to be trusted: its trust, and less, the steeper the place, (N,)."""
    upright = np.abs(touch.normals @ base_T_sensor.rotation[2])
    slope2 = (1 - upright**2) / np.maximum(upright, 1e-3) ** 2
    return np.asarray(touch.trust / (1 + _BESIDE_PER_HEIGHT**2 * np.maximum(slope2, 0)), np.float64)


def _divided(values: F32, by: int) -> F32:
    """Each cell as `by` x `by`, in straight lines between the cells' middles; as at the border beyond them."""
    for axis in (0, 1):
        at = np.clip((np.arange(values.shape[axis] * by) + 0.5) / by - 0.5, 0, values.shape[axis] - 1)
        low = np.minimum(at.astype(np.int64), max(values.shape[axis] - 2, 0))
        part = (at - low).astype(np.float32).reshape((-1, 1) if axis == 0 else (1, -1))
        high = np.minimum(low + 1, values.shape[axis] - 1)
        values = values.take(low, axis=axis) * (1 - part) + values.take(high, axis=axis) * part
    return np.ascontiguousarray(values, np.float32)


def _normals(points: F32) -> F32:
    """Of a grid of points (rows, cols, 3), by central differences; NaN beside a NaN."""
    along, across = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normal = np.cross(along, across)
    return np.asarray(normal / np.linalg.norm(normal, axis=2, keepdims=True), np.float32)
