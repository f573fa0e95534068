"""Select the points of one press for a map, with a confidence for each,
once the pressing robot has come to rest.
"""

from __future__ import annotations

import bisect
import math
from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.core.contact.objects import bounding_box
from tacshade_edge.core.geometry.disc import Grid, disc_rays, radius_squared, skin_points
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F32, F64, Geometry, HeightMap, Pose, frozen

REST_NS = 300_000_000
STEADY_MM = 0.06
_STEADY_FRACTION = 0.03  # of the depth, because a deep contact trembles more
# Confidence grows to 1 over this distance into the contact:
# skin beyond it is skirt, off the object.
OUTLINE_MM = 0.8
RIM_FRACTION = (
    0.2  # outer part of the disc's radius: the camera looks along the skin, and confidence falls
)
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
    if min(h.shape) < 2:
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
    confidence = np.clip(np.minimum(inside_mm / OUTLINE_MM, to_rim), MIN_CONFIDENCE, 1)
    contact = contact & np.isfinite(normals).all(
        axis=2
    )  # drops points with a neighbour outside the disc
    return PressPoints(points[contact], normals[contact], confidence[contact].astype(np.float32))


def height_weight(press: PressPoints, base_T_sensor: Rigid) -> F64:
    """Weight of each point's z in the base frame: its confidence, reduced by the slope."""
    cosine = np.abs(press.normals @ base_T_sensor.rotation[2])
    slope2 = (1 - cosine**2) / np.maximum(cosine, 1e-3) ** 2
    return np.asarray(
        press.confidence / (1 + _LATERAL_RATIO**2 * np.maximum(slope2, 0)), np.float64
    )


GAP_MAX_NS = 250_000_000  # poses farther apart do not show the motion in between
EXTRAPOLATION_MAX_NS = 20_000_000  # at 1 m/s² a straight line is then wrong by 0.2 mm
HISTORY_NS = 5_000_000_000
POSES_MAX = 8192


@dataclass(frozen=True, slots=True)
class InterpolatedPose:
    """A pose, and the time by which it is later than the newest known one."""

    pose: Pose
    extrapolated_ns: int


def interpolate(a: Pose, b: Pose, t_ns: int) -> Pose:
    """The pose at `t_ns` in a uniform motion and rotation by slerp (Shoemake 1985), the shorter
    way, from `a` to `b` (at another time), extrapolated beyond. Two equal poses give that pose to
    the last bit: a robot at rest is at one place.
    """
    fraction = (t_ns - a.t_ns) / (b.t_ns - a.t_ns)
    q, r = (a.qw, a.qx, a.qy, a.qz), (b.qw, b.qx, b.qy, b.qz)
    dot = sum(u * v for u, v in zip(q, r, strict=True))
    if dot < 0:
        dot, r = -dot, (-r[0], -r[1], -r[2], -r[3])
    angle = math.acos(min(dot, 1.0))
    if q == r:
        weights = 1.0, 0.0
    elif angle < 1e-4:  # the sines equal their angles within 1e-9
        weights = 1 - fraction, fraction
    else:
        weights = (
            math.sin((1 - fraction) * angle) / math.sin(angle),
            math.sin(fraction * angle) / math.sin(angle),
        )
    rotated = [weights[0] * u + weights[1] * v for u, v in zip(q, r, strict=True)]
    norm = math.hypot(*rotated)
    qw, qx, qy, qz = (value / norm for value in rotated)
    x, y, z = (
        u + fraction * (v - u) for u, v in ((a.x_mm, b.x_mm), (a.y_mm, b.y_mm), (a.z_mm, b.z_mm))
    )
    return Pose(t_ns, x, y, z, qw, qx, qy, qz)


class PoseBuffer:
    """The latest poses in order of time, all of one clock, for one thread; `late` counts those
    dropped because they were not later.
    """

    def __init__(self) -> None:
        self.late = 0
        self._poses: deque[Pose] = deque(maxlen=POSES_MAX)

    def add(self, pose: Pose) -> None:
        """Keep a pose."""
        poses = self._poses
        if poses and pose.t_ns <= poses[-1].t_ns:
            self.late += 1
            return
        poses.append(pose)
        while pose.t_ns - poses[0].t_ns > HISTORY_NS:
            poses.popleft()

    def clear(self) -> None:
        """Drop all poses, because the next ones are of another clock."""
        self._poses.clear()

    def at(self, t_ns: int) -> InterpolatedPose | None:
        """The pose between two poses at most `GAP_MAX_NS` apart,
        or at most `EXTRAPOLATION_MAX_NS` after the newest.
        """
        poses = self._poses
        if len(poses) < 2 or t_ns < poses[0].t_ns:
            return None
        after = bisect.bisect_left(poses, t_ns, key=lambda pose: pose.t_ns)
        extrapolated_ns = max(0, t_ns - poses[-1].t_ns)
        after = min(max(after, 1), len(poses) - 1)
        a, b = poses[after - 1], poses[after]
        if extrapolated_ns > EXTRAPOLATION_MAX_NS or (
            b.t_ns - a.t_ns > GAP_MAX_NS and t_ns not in (a.t_ns, b.t_ns)
        ):
            return None
        return InterpolatedPose(interpolate(a, b, t_ns), extrapolated_ns)
