"""Place balls and indenters of other shapes, and compute where their surface lies in a press.

Every shape but a ball is a closed surface of triangles; round sides have `SIDES` flats with corners
on the circle, at most 3e-4 radii inside it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import DiscRays, disc_rays
from tacshade_edge.types import F32, F64, I64, Geometry, frozen

SIDES = 128
"""Number of flats of a round side."""
# Heights of an upright shape's corners, mm: the last is beyond any skin.
_LEVELS_MM = (0.0, 2.0, 8.0, 32.0, 128.0, 512.0)
# Triangles nearer to the lens than this, in skin sizes, are ignored: no image shows them.
_LEAST_RANGE = 1e-3
# The search for the first touch ends at a step below this (skin radii), or after this many steps.
_TOUCH_STEP, _TOUCH_STEPS = 1e-9, 200
# A cell this far outside a triangle, in its areas, counts as inside, so that rounding leaves no
# gap. Pairs are processed in parts of this size, to bound the memory.
_EDGE, _PAIRS = 1e-9, 1 << 20


@dataclass(frozen=True, slots=True)
class Ball:
    """A pressed ball: its centre in the sensor frame, and its radius."""

    x_mm: float
    y_mm: float
    z_mm: float
    radius_mm: float

    def depth_max_mm(self, skin_radius_mm: float) -> float:
        """Greatest h of the skin under it, mm."""
        if math.isinf(skin_radius_mm):
            return self.radius_mm - self.z_mm
        return skin_radius_mm - math.hypot(self.x_mm, self.y_mm, self.z_mm) + self.radius_mm

    def first_touch_mm(self, skin_radius_mm: float) -> float:
        """The depth at which it first touches the undeformed skin, moving along -z: at most 0."""
        if math.isinf(skin_radius_mm):
            return 0.0
        touch_z = skin_z_mm(skin_radius_mm + self.radius_mm, self.x_mm, self.y_mm)
        return skin_z_mm(skin_radius_mm, self.x_mm, self.y_mm) - (touch_z - self.radius_mm)

    def deeper(self, by_mm: float) -> Ball:
        """The same ball pressed deeper."""
        return Ball(self.x_mm, self.y_mm, self.z_mm - by_mm, self.radius_mm)


@frozen
class Indenter:
    """A solid in its own frame, of triangles (N, 3, 3): the lowest point has z = 0;
    z points away from the sensor.
    """

    name: str
    triangles_mm: F64


@frozen
class PlacedIndenter:
    """An indenter in a press, in the sensor frame:
    its origin's place, depth as in PRESSES.csv, triangles (N, 3, 3).
    """

    x_mm: float
    y_mm: float
    depth_mm: float
    triangles_mm: F64

    def depth_max_mm(self, skin_radius_mm: float) -> float:
        """Greatest h of the skin under it, mm; negative if it is above the skin."""
        if math.isinf(skin_radius_mm):
            return -float(self.triangles_mm[..., 2].min())
        return skin_radius_mm - float(np.linalg.norm(_nearest(self.triangles_mm)))

    def first_touch_mm(self, skin_radius_mm: float) -> float:
        """Find the depth in mm at which it first touched the undeformed skin, moving along -z;
        else its own depth.
        """
        if math.isinf(skin_radius_mm):
            return self.depth_mm + float(self.triangles_mm[..., 2].min())
        # A copy, because the loop below moves it in place.
        lifted, travel = self.triangles_mm + 0.0, 0.0
        for _ in range(_TOUCH_STEPS):
            x, y, z = _nearest(lifted)[0]
            # At least the deepest point must come out, so this never lifts too far.
            step = skin_z_mm(skin_radius_mm, x, y) - z
            if math.hypot(x, y, z) >= skin_radius_mm or step <= _TOUCH_STEP * skin_radius_mm:
                break
            lifted[..., 2] += step
            travel += step
        return self.depth_mm - travel

    def deeper(self, by_mm: float) -> PlacedIndenter:
        """The same indenter pressed deeper."""
        return PlacedIndenter(
            self.x_mm, self.y_mm, self.depth_mm + by_mm, self.triangles_mm - (0.0, 0.0, by_mm)
        )

    def height_mm(self, rays: DiscRays, geometry: Geometry) -> F32:
        """Heights h (rows, cols) where camera rays first meet the surface;
        NaN outside disc and undeformed skin.
        """
        r, d = geometry.skin_radius_mm, geometry.camera_distance_mm
        lowest = self.triangles_mm[..., 2].min(axis=1)
        flat = geometry.skin == "pad"
        near = lowest < 0
        if not flat:
            near = np.linalg.norm(_nearest(self.triangles_mm, of_each=True), axis=1) < r
        if d is not None:
            near &= lowest > _LEAST_RANGE * geometry.size_mm - d
        # Project: planes stay planes, and the highest point is the one that a ray meets first.
        x, y, z = np.moveaxis(self.triangles_mm[near], -1, 0)
        u, v = rays.u.astype(np.float64), rays.v.astype(np.float64)
        if d is None:
            z = -_upper_envelope(np.stack((x, y, -z), axis=-1), u[0], v[:, 0])
            height = -z if flat else r - np.sqrt(u * u + v * v + z * z)
        else:
            s = 1 / _upper_envelope(
                np.stack((x, y, np.ones_like(z)), axis=-1) / (z + d)[..., None], u[0], v[:, 0]
            )
            height = d - s if flat else r - np.sqrt(s * s * (u * u + v * v) + (s - d) ** 2)
        return np.where(rays.inside & (height > 0), height, np.nan).astype(np.float32)


Placed = Ball | PlacedIndenter
"""Any indenter in its place."""


def cylinder(name: str, radius_mm: float) -> Indenter:
    """Make a cylinder that stands on its flat end."""
    return Indenter(name, surface([level(circle(radius_mm), z) for z in _LEVELS_MM]))


def box(name: str, length_mm: float, width_mm: float) -> Indenter:
    """Make a box with its flat face down, `length_mm` along x by `width_mm` along y."""
    corners = np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * (length_mm / 2, width_mm / 2)
    return Indenter(name, surface([level(corners, z) for z in _LEVELS_MM]))


def bar(name: str, radius_mm: float, length_mm: float) -> Indenter:
    """Make a cylinder that lies along x, with flat ends."""
    x, y, z = np.moveaxis(surface([level(circle(radius_mm), z) for z in (0.0, length_mm)]), -1, 0)
    return Indenter(name, np.stack((z - length_mm / 2, y, radius_mm - x), axis=-1))


def cone(name: str, angle_deg: float) -> Indenter:
    """Make a cone on its tip; `angle_deg` is the full angle there."""
    slope = math.tan(math.radians(angle_deg) / 2)
    return Indenter(name, surface([level(circle(slope * z), z) for z in _LEVELS_MM]))


def mesh(name: str, triangles_mm: F64) -> Indenter:
    """Make an indenter of triangles (float64 (N, 3, 3), N at least 1),
    shifted so that its lowest point has z = 0.
    """
    return Indenter(name, triangles_mm - (0.0, 0.0, float(triangles_mm[..., 2].min())))


def skin_z_mm(skin_radius_mm: float, x_mm: float, y_mm: float) -> float:
    """The undeformed skin's z at (x, y), mm; 0 beside a dome and on a pad,
    whose radius is infinite.
    """
    if math.isinf(skin_radius_mm):
        return 0.0
    return math.sqrt(max(skin_radius_mm**2 - x_mm**2 - y_mm**2, 0.0))


def place(
    indenter: Indenter,
    skin_radius_mm: float,
    x_mm: float,
    y_mm: float,
    depth_mm: float,
    yaw_deg: float = 0.0,
    tilt_x_deg: float = 0.0,
    tilt_y_deg: float = 0.0,
) -> PlacedIndenter:
    """Place an indenter as a row of PRESSES.csv states (docs/reference/calibration-files.md):
    turned by yaw about z (from x towards y), then tilted about x, then y, all through its origin,
    which is then shifted over (x, y) until its lowest point lies `depth_mm` under the undeformed
    skin at (x, y).
    """
    a, b, c = (math.radians(angle) for angle in (yaw_deg, tilt_x_deg, tilt_y_deg))
    about_z = np.array(((math.cos(a), -math.sin(a), 0), (math.sin(a), math.cos(a), 0), (0, 0, 1)))
    about_x = np.array(((1, 0, 0), (0, math.cos(b), -math.sin(b)), (0, math.sin(b), math.cos(b))))
    about_y = np.array(((math.cos(c), 0, math.sin(c)), (0, 1, 0), (-math.sin(c), 0, math.cos(c))))
    # Row vectors, hence the transpose: yaw comes first, then the tilts.
    turned = indenter.triangles_mm @ (about_y @ about_x @ about_z).T
    z_mm = skin_z_mm(skin_radius_mm, x_mm, y_mm) - depth_mm - float(turned[..., 2].min())
    return PlacedIndenter(x_mm, y_mm, depth_mm, turned + np.array((x_mm, y_mm, z_mm)))


def stated_ball(
    skin_radius_mm: float, x_mm: float, y_mm: float, depth_mm: float, radius_mm: float
) -> Ball:
    """Place a ball pressed along -z (docs/reference/calibration-files.md defines its depth)."""
    return Ball(x_mm, y_mm, skin_z_mm(skin_radius_mm, x_mm, y_mm) - depth_mm + radius_mm, radius_mm)


def ball_along(skin_radius_mm: float, along: F64, depth_mm: float, radius_mm: float) -> Ball:
    """Place a ball in the direction from O of the middle of its contact, which is also that of its
    centre; on a pad, `along` is that middle.
    """
    if math.isinf(skin_radius_mm):
        return stated_ball(skin_radius_mm, float(along[0]), float(along[1]), depth_mm, radius_mm)
    reach = skin_radius_mm - depth_mm + radius_mm
    # The depth counts from the skin under (x, y), which moves with the reach, so iterate to the
    # fixed point.
    for _ in range(8):
        reach = (
            stated_ball(
                skin_radius_mm, reach * along[0], reach * along[1], depth_mm, radius_mm
            ).z_mm
            / along[2]
        )
    return stated_ball(
        skin_radius_mm, float(reach * along[0]), float(reach * along[1]), depth_mm, radius_mm
    )


def known_height(geometry: Geometry, placed: Placed, cells: int = disc_map.CELLS) -> F32:
    """Height h of an indenter at the map's cells, mm;
    NaN or below 0 where it is not inside the undeformed skin.
    """
    rays = disc_rays(disc_map.map_grid(geometry.disc, cells), geometry)
    if not isinstance(placed, Ball):
        return placed.height_mm(rays, geometry)
    height = ball_height_along(
        geometry, placed, rays.u.astype(np.float64), rays.v.astype(np.float64)
    )
    return np.where(rays.inside, height, np.nan).astype(np.float32)


def ball_height_along(geometry: Geometry, ball: Ball, u: F64, v: F64) -> F64:
    """Height h of the ball's surface along rays (u, v) of `DiscRays`, mm; NaN where a ray misses
    it. By components, because numpy sums over an axis of three many times slower.
    """
    if geometry.camera_distance_mm is None:
        origin = (u, v, np.zeros_like(u))
        along = (np.zeros_like(u), np.zeros_like(u), np.ones_like(u))
    else:
        origin = (np.zeros_like(u), np.zeros_like(u), np.full_like(u, -geometry.camera_distance_mm))
        length = np.sqrt(u * u + v * v + 1)
        along = (u / length, v / length, 1 / length)
    offset = (ball.x_mm - origin[0], ball.y_mm - origin[1], ball.z_mm - origin[2])
    foot = _dot(offset, along)
    inside = ball.radius_mm**2 - (_dot(offset, offset) - foot * foot)
    s = foot - np.sqrt(np.where(inside > 0, inside, np.nan))
    met = (origin[0] + s * along[0], origin[1] + s * along[1], origin[2] + s * along[2])
    if geometry.skin == "pad":
        return np.asarray(-met[2])
    return np.asarray(geometry.skin_radius_mm - np.sqrt(_dot(met, met)))


def _dot(a: tuple[F64, F64, F64], b: tuple[F64, F64, F64]) -> F64:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def circle(radius_mm: float) -> F64:
    """Corners (SIDES, 2) on a circle, counter-clockwise from x."""
    angle = 2 * math.pi * np.arange(SIDES) / SIDES
    return radius_mm * np.column_stack((np.cos(angle), np.sin(angle)))


def level(outline: F64, z_mm: float) -> F64:
    """Lift an outline (N, 2) to a ring (N, 3)."""
    return np.column_stack((outline, np.full(len(outline), z_mm)))


def surface(rings: Sequence[F64]) -> F64:
    """Triangles (N, 3, 3), counter-clockwise from outside, of rings (N, 3), the lowest first;
    both ends are closed.
    """
    faces = []
    for low, high in itertools.pairwise(rings):
        low_after, high_after = np.roll(low, -1, axis=0), np.roll(high, -1, axis=0)
        faces += [(low, low_after, high), (low_after, high_after, high)]
    for ring, is_top in ((rings[0], False), (rings[-1], True)):
        middle, after = np.broadcast_to(ring.mean(axis=0), ring.shape), np.roll(ring, -1, axis=0)
        faces.append((middle, ring, after) if is_top else (middle, after, ring))
    return np.concatenate([np.stack(face, axis=1) for face in faces])


def _nearest(triangles: F64, *, of_each: bool = False) -> F64:
    """The point (1, 3) nearest to the sensor's centre O, or that of each triangle (N, 3)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    normal = np.cross(b - a, c - a)
    norm2 = np.maximum(np.einsum("ij,ij->i", normal, normal), np.finfo(float).tiny)
    foot = (np.einsum("ij,ij->i", a, normal) / norm2)[:, None] * normal
    beside = np.zeros(len(a), bool)
    candidates = [foot]
    for p, q in ((a, b), (b, c), (c, a)):
        beside |= ~(np.einsum("ij,ij->i", np.cross(q - p, foot - p), normal) > 0)
        candidates.append(p + _share(p, q)[:, None] * (q - p))
    points = np.stack(candidates)
    distance2 = np.einsum("kij,kij->ki", points, points)
    # The foot of the perpendicular counts only inside its triangle; else an edge is nearest.
    distance2[0, beside] = np.inf
    each: F64 = points[np.argmin(distance2, axis=0), np.arange(len(a))]
    return each if of_each else each[[int(np.argmin(distance2.min(axis=0)))]]


def _share(p: F64, q: F64) -> F64:
    """The position on each edge, 0 at p to 1 at q, of its point nearest to the origin."""
    edge = q - p
    length2 = np.maximum(np.einsum("ij,ij->i", edge, edge), np.finfo(float).tiny)
    return np.asarray(np.clip(-np.einsum("ij,ij->i", p, edge) / length2, 0, 1))


def _upper_envelope(triangles: F64, x: F64, y: F64) -> F64:
    """The highest z of triangles (N, 3, 3) over each point of a grid with axes x (cols,) and y
    (rows,); NaN off all.
    """
    highest = np.full((len(y), len(x)), -np.inf)
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    col0, row0 = np.searchsorted(x, low[:, 0]), np.searchsorted(y, low[:, 1])
    cols = np.searchsorted(x, high[:, 0], "right") - col0
    counts = cols * (np.searchsorted(y, high[:, 1], "right") - row0)
    for some in _in_parts(counts):
        # All pairs of a triangle and a cell in its bounding box.
        which = np.repeat(some, counts[some])
        k = np.arange(len(which)) - np.repeat(np.cumsum(counts[some]) - counts[some], counts[some])
        row, col = row0[which] + k // cols[which], col0[which] + k % cols[which]
        point = np.stack((x[col], y[row]), axis=-1)
        a, b, c = np.moveaxis(triangles[which, :, :2], 1, 0)
        areas = [_cross(q - p, point - p) for p, q in ((b, c), (c, a), (a, b))]
        whole = _cross(b - a, c - a)
        within = (whole != 0) & (np.min(areas * np.sign(whole), axis=0) >= -_EDGE * np.abs(whole))
        shares = np.stack(areas)[:, within] / whole[within]
        z = np.einsum("ki,ik->i", shares, triangles[which[within], :, 2])
        np.maximum.at(highest, (row[within], col[within]), z)
    return np.where(np.isfinite(highest), highest, np.nan)


def _in_parts(counts: I64) -> list[I64]:
    """Split the indices of all triangles into runs of about `_PAIRS` pairs."""
    ends = np.cumsum(counts) // _PAIRS
    return np.split(np.arange(len(counts)), np.flatnonzero(np.diff(ends)) + 1)


def _cross(p: F64, q: F64) -> F64:
    return np.asarray(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
