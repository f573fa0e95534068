"""Describe what touches by numbers that do not change when it is turned about z, and little with
place and depth.

The skin in contact lies on the object, so in the sensor frame it is a piece of the object's own
surface, whatever dome was pressed. Three kinds of numbers describe it:

- On rings around the middle of the contact, magnitudes of the harmonics of the angle of three
  fields: where the skin touches, how far the object's surface rises above its lowest point, and how
  deep the skin is.
- Wherever the middle may be: how much of the contact has which slope and which curvatures, and
  harmonics of the directions of its outline, edges and slopes, by which straight sides differ from
  round ones.
- Moments of the contact, a quadric fitted to its form, its outline, and the depth and place of the
  press.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np

from tacshade_edge.sensor.geometry.disc import DiscRays, skin_planes
from tacshade_edge.types import F32, F64, Bool, Geometry

MARGIN_MM = 3.0  # of skin around the contact that is described with it
RINGS, RING_MM = 9, 1.25  # their number and distance; the first is the middle
ORDERS = 7  # of the harmonics on a ring, from 0
DIRECTIONS = 8  # number of the harmonics of directions, from 1
LEAST_CELLS = 6  # fewer have no form
LOWEST_PART = 0.05  # of the contact's cells, which lie below what counts as its lowest point
# Of heights before they are differentiated; least in cells.
SMOOTHING_MM, LEAST_SMOOTHING = 0.35, 0.5
OUTLINE_SMOOTHING_MM, LEAST_OUTLINE_SMOOTHING = 0.5, 0.7
# Classes of slope and curvature, closer where most contacts have theirs.
_SLOPES = np.array((0.0, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5), np.float32)
_BENDS_PER_MM = np.array((-0.4, -0.2, -0.1, -0.05, 0.0, 0.05, 0.1, 0.2, 0.4, 0.8), np.float32)
_NEAR = 0.05  # of the smoothed contact: bends farther outside are the free skin's
_SOBEL = 1 / 8  # makes OpenCV's sum a derivative per cell
_NOTHING = 1e-6


def describe(height_mm: F32, touched: Bool, rays: DiscRays, geometry: Geometry) -> F32 | None:
    """Describe the skin at cells `touched` of a map, of which h is known: float32 (D,), signed
    roots; None for fewer than `LEAST_CELLS`.
    """
    if np.count_nonzero(touched) < LEAST_CELLS:
        return None
    box = _around(touched, rays, geometry)
    height, own = np.nan_to_num(height_mm[box]), touched[box]
    x, y, z = skin_planes(height, rays.part(box), geometry)
    weight = _cell_mm2(z, rays, geometry)
    inside = weight * own
    area = float(inside.sum())
    x0, y0 = (float((inside * each).sum()) / area for each in (x, y))
    dx, dy = x - x0, y - y0
    lowest = _lowest(z[own])
    rise = (z - np.float32(lowest)) * own
    depth = float(height[own].max())
    local = _local(z, own, weight, geometry)
    fullness = float((inside * height).sum()) / area / max(depth, _NOTHING)
    numbers = np.concatenate(
        (
            _on_rings(dx[own], dy[own], np.stack((inside[own], (inside * rise)[own]))),
            _on_rings(dx.ravel(), dy.ravel(), (weight * height).reshape(1, -1)),
            local,
            _moments(dx, dy, inside, area),
            _quadric(dx[own], dy[own], rise[own], inside[own]),
            _outline(own),
            (depth, fullness, math.hypot(x0, y0), lowest, geometry.skin_radius_mm),
        )
    )
    # Signed roots: otherwise a few great numbers outweigh all others in the metric.
    return np.asarray(np.sign(numbers) * np.sqrt(np.abs(numbers)), np.float32)


def _lowest(z: F32) -> float:
    """The quantile `LOWEST_PART`, a tenth of what `np.quantile` costs."""
    place = LOWEST_PART * (len(z) - 1)
    low = int(place)
    ordered = np.partition(z, (low, low + 1))
    one, other = ordered[low : low + 2].tolist()
    return float(one + (place - low) * (other - one))


def _around(touched: Bool, rays: DiscRays, geometry: Geometry) -> tuple[slice, slice]:
    """The contact's rows and columns, and `MARGIN_MM` on each side."""
    left, top, width, height = cv2.boundingRect(touched.view(np.uint8))
    distance = 1.0
    if geometry.camera_distance_mm is not None:
        distance = geometry.camera_distance_mm + geometry.skin_radius_mm
    margin = math.ceil(MARGIN_MM / (_step(rays) * distance))
    return (
        slice(max(top - margin, 0), top + height + margin),
        slice(max(left - margin, 0), left + width + margin),
    )


def _step(rays: DiscRays) -> float:
    """Slope between the rays of neighbouring cells (orthographic: their distance, mm)."""
    return float(rays.u[0, 1] - rays.u[0, 0])


def _cell_mm2(z: F32, rays: DiscRays, geometry: Geometry) -> F32:
    """Area of each cell seen along z, mm²."""
    side = np.full_like(z, _step(rays))
    if geometry.camera_distance_mm is not None:
        side *= z + np.float32(geometry.camera_distance_mm)
    return np.asarray(side * side)


def _on_rings(dx: F32, dy: F32, fields: F32) -> F32:
    """Magnitudes (fields · RINGS · ORDERS,) of the harmonics of the angle of fields (fields, N), on
    each ring, per mm² of the ring.
    """
    radius = _length(dx, dy)
    near = np.flatnonzero(radius < RINGS * RING_MM)
    waves = np.ones((2 * ORDERS - 1, len(near)), np.float32)
    _powers(dx.take(near), dy.take(near), waves[1:ORDERS], waves[ORDERS:])
    rings = np.arange(RINGS, dtype=np.float32)[:, None]
    # A cell counts for the two rings beside it, more for the nearer one: as a contact grows, no
    # number jumps.
    hats = np.maximum(0, 1 - np.abs(radius.take(near) / np.float32(RING_MM) - rings))
    values = fields[:, None, near] * hats
    sums = (values.reshape(-1, len(near)) @ waves.T).reshape(len(fields), RINGS, -1)
    # The magnitudes, because a turn about z changes only the phases. Order 0 has no sine.
    made = np.abs(sums[..., :ORDERS])
    made[..., 1:] = np.hypot(sums[..., 1:ORDERS], sums[..., ORDERS:])
    # The middle ring is a disc: under its hat lies a sixth of 2π RING_MM².
    areas = 2 * math.pi * RING_MM**2 * np.maximum(rings, 1 / 6)
    return np.asarray((made / areas).ravel())


def _local(z: F32, own: Bool, weight: F32, geometry: Geometry) -> F64:
    """What the contact is made of: parts of slopes and curvatures, harmonics of directions, bends
    in all and length of the outline.
    """
    side = math.sqrt(float(weight[own].mean()))
    smooth = cv2.GaussianBlur(z, (0, 0), max(SMOOTHING_MM / side, LEAST_SMOOTHING))
    z_x, z_y = _gradient(smooth, side)
    (xx, xy), yy = _gradient(z_x, side), _gradient(z_y, side)[1]
    # Eigenvalues of the second derivatives are mean ± apart: the principal curvatures, as far as
    # slopes are small.
    mean, apart = _half(xx + yy), _length(_half(xx - yy), xy)
    slope = _length(z_x, z_y)
    share = weight[own] / weight[own].sum()
    parts = (
        _parts(slope[own], share, _SLOPES),
        _parts((mean + apart)[own], share, _BENDS_PER_MM),
        _parts((mean - apart)[own], share, _BENDS_PER_MM),
    )
    blur = max(OUTLINE_SMOOTHING_MM / side, LEAST_OUTLINE_SMOOTHING)
    touched = cv2.GaussianBlur(own.astype(np.float32), (0, 0), blur)
    o_x, o_y = _gradient(touched, side)
    outline = _length(o_x, o_y)
    # A free dome bends by 1 / r by itself; what exceeds twice that is an edge of the object.
    bend = np.maximum(mean + apart - np.float32(2 / geometry.skin_radius_mm), 0) * (touched > _NEAR)
    sides = _directions(o_x, o_y, np.stack((outline, outline * bend)))
    slopes = _directions(z_x, z_y, np.stack((bend * weight, slope * own * weight)))
    totals = (
        math.log(float((bend * weight).sum()) + 1e-3),
        math.log(float((outline * weight).sum()) + 1e-3),
    )
    return np.concatenate((*parts, sides[0], *slopes, sides[1], totals))


def _length(x: F32, y: F32) -> F32:
    """The length of vectors in mm, for which `np.hypot` takes needless care of overflow."""
    return np.asarray(np.sqrt(x * x + y * y))


def _half(values: F32) -> F32:
    return values * np.float32(0.5)


def _gradient(values: F32, side_mm: float) -> tuple[F32, F32]:
    """Derivatives along x and y per mm."""
    scale = _SOBEL / side_mm
    return (
        np.asarray(cv2.Sobel(values, cv2.CV_32F, 1, 0, scale=scale), np.float32),
        np.asarray(cv2.Sobel(values, cv2.CV_32F, 0, 1, scale=scale), np.float32),
    )


def _parts(values: F32, share: F32, classes: F32) -> F64:
    """The part of the contact near each class; a value between two classes counts for both."""
    at = np.interp(values, classes, np.arange(len(classes)))
    low = np.minimum(at.astype(np.intp), len(classes) - 2)
    rest = at - low
    count = len(classes)
    return np.asarray(
        np.bincount(low, share * (1 - rest), count) + np.bincount(low + 1, share * rest, count)
    )


def _directions(x: F32, y: F32, weights: F32) -> F64:
    """Magnitudes (sets, `DIRECTIONS`) of the harmonics of vectors' directions, for each set of
    weights: all 1 where the directions are the same.
    """
    flat = weights.reshape(len(weights), -1)
    some = np.flatnonzero(flat.max(axis=0) > _NOTHING)
    if not some.size:
        return np.zeros((len(weights), DIRECTIONS))
    known = flat[:, some]
    waves = np.empty((2 * DIRECTIONS, len(some)), np.float32)
    _powers(x.take(some), y.take(some), waves[:DIRECTIONS], waves[DIRECTIONS:])
    sums = known @ waves.T
    sizes = np.hypot(sums[:, :DIRECTIONS], sums[:, DIRECTIONS:])
    total = np.maximum(known.sum(axis=1, keepdims=True), _NOTHING)
    return np.asarray(sizes / total, float)


def _powers(x: F32, y: F32, cosines: F32, sines: F32) -> None:
    """Fill the cosines and sines (orders, N) of 1, 2, 3 ... times the angles of vectors (N,): each
    order is the product of the one before and the first, far cheaper than trigonometric functions.
    """
    length = np.maximum(_length(x, y), np.float32(_NOTHING))
    cosine, sine = x / length, y / length
    cosines[0], sines[0] = cosine, sine
    for order in range(1, len(cosines)):
        c, s = cosines[order - 1], sines[order - 1]
        cosines[order] = c * cosine - s * sine
        sines[order] = c * sine + s * cosine


def _moments(dx: F32, dy: F32, inside: F32, area: float) -> tuple[float, ...]:
    """Root of each principal second moment, mm, their ratio, a fourth moment, fullness of the
    ellipse, log of area.
    """
    xx, yy, xy = (float((inside * a * b).sum()) / area for a, b in ((dx, dx), (dy, dy), (dx, dy)))
    middle, apart = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
    r2 = dx * dx + dy * dy
    fourth = float((inside * r2 * r2).sum()) / area / max(2 * middle, _NOTHING) ** 2
    fullness = area / (4 * math.pi * math.sqrt(max(middle**2 - apart**2, _NOTHING)))
    long, short = math.sqrt(middle + apart), math.sqrt(max(middle - apart, 0.0))
    return long, short, short / max(long, _NOTHING), fourth, fullness, math.log(area)


def _quadric(dx: F32, dy: F32, rise: F32, weight: F32) -> tuple[float, ...]:
    """Slope, mean and difference of the curvatures (1/mm) of a quadric fitted to the form, the RMS
    that it leaves and that a plane leaves, and the greatest rise, mm.
    """
    terms = np.stack((np.ones_like(dx), dx, dy, dx * dx + dy * dy, dx * dx - dy * dy, 2 * dx * dy))
    weighted = terms * weight
    normal, right = (weighted @ terms.T).astype(np.float64), (weighted @ rise).astype(np.float64)
    total = float(weight.sum())
    # A ridge, as few cells show no curvature; the small system in float64, the long sums above not.
    normal += np.diag((1e-6, 1e-3, 1e-3, 1.0, 1.0, 1.0)) * total
    found = np.linalg.solve(normal, right)
    plane = np.linalg.solve(normal[:3, :3], right[:3])
    left = (rise - found.astype(np.float32) @ terms, rise - plane.astype(np.float32) @ terms[:3])
    rms = (math.sqrt(float((weight * each * each).sum()) / total) for each in left)
    slope, across = math.hypot(found[1], found[2]), math.hypot(found[4], found[5])
    return slope, float(found[3]), across, *rms, float(rise.max())


def _outline(own: Bool) -> tuple[float, ...]:
    """Log of the number of parts; of the convex hull, what touches and what is hollow; length of
    the outline against that of a disc.
    """
    contours, levels = cv2.findContours(own.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    is_hole = levels[0][:, 3] >= 0
    outer = [c for c, hole in zip(contours, is_hole, strict=True) if not hole]
    cells = float(np.count_nonzero(own))
    hull = cv2.convexHull(np.concatenate(outer))
    # Pick's theorem, as in `parting`: a contour runs through the middles of its cells.
    hull_cells = max(cv2.contourArea(hull) + cv2.arcLength(hull, closed=True) / 2 + 1, cells)
    hollow = sum(_areas(c for c, hole in zip(contours, is_hole, strict=True) if hole))
    length = sum(cv2.arcLength(c, closed=True) for c in outer)
    return (
        math.log(len(outer)),
        cells / hull_cells,
        hollow / hull_cells,
        length / math.sqrt(4 * math.pi * cells),
    )


def _areas(contours: Iterator[object]) -> Iterator[float]:
    return (cv2.contourArea(each) for each in contours)
