"""Where a sensor's pins are: found one by one in the reference, or on a lattice."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from tacshade_edge.lab.simulator.render import equal_area_to_direction, project
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.types import F32, F64, Calibration, Geometry

NOMINAL_PITCHES = 1.6
"""Length of pins with which tips are placed on a chart."""


@dataclass(frozen=True, slots=True, eq=False)
class Tips:
    """Pins where their tips appear in the image, col and row, one by one."""

    px: F64


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Tips of pins on a lattice of the equal-area chart, in mm:
    its origin, its steps, its widening to the rim.

    The tips are those of pins `NOMINAL_PITCHES` long: where tips appear is known well, and so does
    not depend on the length that is fitted.
    """

    values: F64

    def at(self, steps: F64, radius_mm: float) -> F64:
        """The points (N, 2) that are so many steps (N, 2) from the origin."""
        flat = self.values[0:2] + steps @ self.values[2:6].reshape(2, 2)
        return np.asarray(
            flat * (1 + self.values[6] * (flat * flat).sum(axis=1, keepdims=True) / radius_mm**2)
        )

    def steps(
        self,
        radius_mm: float,
        limit_mm: float,
        parts: Sequence[tuple[float, float]] = ((0.0, 0.0),),
    ) -> F64:
        """Numbers of steps (N, 2), shifted by parts of steps, that end within a limit."""
        n = (
            math.ceil(1.5 * limit_mm / np.linalg.norm(self.values[2:6].reshape(2, 2), axis=1).min())
            + 2
        )
        whole = np.stack(np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1)), axis=-1).reshape(
            -1, 2
        )
        steps = np.concatenate([whole + np.array(part) for part in parts])
        return np.asarray(steps[np.linalg.norm(self.at(steps, radius_mm), axis=1) < limit_mm])


Layout = Tips | Lattice


def sphere_points(geometry: Geometry, col_row: F64, radius_mm: float) -> F64:
    """Where the rays of image points meet a sphere around O, (N, 3) in mm (the farther root)."""
    disc = geometry.disc
    x, y = col_row[:, 0] - disc.col_c, col_row[:, 1] - disc.row_c
    if geometry.camera_distance_mm is None:
        u, v = x * geometry.mm_per_px, y * geometry.mm_per_px
        return np.stack((u, v, np.sqrt(np.maximum(radius_mm**2 - u * u - v * v, 1e-6))), axis=1)
    d, a, b = geometry.camera_distance_mm, x / geometry.f_px, y / geometry.f_px
    k = 1 + a * a + b * b
    s = (d + np.sqrt(np.maximum(d * d - k * (d * d - radius_mm**2), 1e-6))) / k
    return np.stack((a * s, b * s, s - d), axis=1)


def equal_area(points: F64, radius_mm: float) -> F64:
    """Points (N, 3) in Lambert's equal-area chart of a sphere, in mm."""
    d = points / np.linalg.norm(points, axis=1, keepdims=True)
    return np.asarray(d[:, :2] * np.sqrt(2 / (1 + d[:, 2]))[:, None] * radius_mm)


def pitch_mm_of(calibration: Calibration) -> float:
    """Pitch on the skin at the tip."""
    geometry = calibration.geometry
    if geometry.camera_distance_mm is None:
        return calibration.pitch_px * geometry.mm_per_px
    return (
        calibration.pitch_px
        * (geometry.skin_radius_mm + geometry.camera_distance_mm)
        / geometry.f_px
    )


def find_tips(
    calibration: Calibration, white_tips: bool, length_pitches: float, divided: bool = False
) -> F64:
    """Image points (N, 2), col and row, of blobs that are about a pitch apart; with `divided`,
    brightness is relative to its surroundings, so that tips in the shade count like those under a
    lamp.
    """
    geometry, disc = calibration.geometry, calibration.geometry.disc
    # On a chart of equal area, where pins stand as densely at the rim as in the middle.
    pitch_mm = pitch_mm_of(calibration)
    radius_mm, px_mm = geometry.skin_radius_mm - length_pitches * pitch_mm, pitch_mm / 12
    limit = 2 * radius_mm * math.sin(math.radians(geometry.visible_half_angle_deg) / 2)
    n = int(limit / px_mm)
    axis = np.arange(-n, n + 1) * px_mm
    chart = np.stack([each.ravel() for each in np.meshgrid(axis, axis)], axis=1)
    chart *= np.minimum(
        1, 1.3 * limit / np.maximum(np.linalg.norm(chart, axis=1, keepdims=True), 1e-9)
    )
    at = project(geometry, equal_area_to_direction(chart, radius_mm) * radius_mm).astype(np.float32)
    cols, rows = (np.ascontiguousarray(at[:, k].reshape(2 * n + 1, 2 * n + 1)) for k in (0, 1))
    grey = calibration.reference_grey.astype(np.float32)
    mask = disc_mask(grey.shape[0], grey.shape[1], disc).astype(np.float32)
    sigma = 1.2 * calibration.pitch_px
    local = cv2.GaussianBlur(grey * mask, (0, 0), sigma) / np.maximum(
        cv2.GaussianBlur(mask, (0, 0), sigma), 1e-3
    )
    contrast = grey / np.maximum(local, 1) - 1 if divided else grey - local
    seen = cv2.remap((contrast * mask).astype(np.float32), cols, rows, cv2.INTER_LINEAR)
    inside = cv2.remap(mask, cols, rows, cv2.INTER_LINEAR) > 0.99
    # Steps of the chart are a twelfth of the pitch; the blur has about the size of a tip.
    blob = cv2.GaussianBlur(seen if white_tips else -seen, (0, 0), 0.22 * 12)
    top = cv2.dilate(blob, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (13, 13)))
    peak = (blob >= top) & inside & (blob > 0.25 * np.percentile(blob[inside], 97))
    # A parabola needs a neighbour on each side.
    peak[[0, -1]] = False
    peak[:, [0, -1]] = False
    i, j = np.nonzero(peak)
    if not len(i):
        return np.zeros((0, 2))
    found = np.stack(
        (
            j + _vertex(blob[i, j - 1], blob[i, j], blob[i, j + 1]),
            i + _vertex(blob[i - 1, j], blob[i, j], blob[i + 1, j]),
        ),
        axis=1,
    )
    points = (found - n) * px_mm
    return project(geometry, equal_area_to_direction(points, radius_mm) * radius_mm)


def _vertex(before: F32, at: F32, after: F32) -> F64:
    """Offset of a parabola's vertex."""
    # Not flat: a plateau would put the vertex anywhere.
    curve = np.minimum(before - 2 * at + after, -1e-6)
    return np.asarray(np.clip(0.5 * (before - after) / curve, -0.5, 0.5), np.float64)


def find_lattice(calibration: Calibration, tips_px: F64, length_pitches: float) -> Lattice | None:
    """The lattice on which the pins in the middle of the disc stand; None if they stand on none."""
    geometry, pitch = calibration.geometry, pitch_mm_of(calibration)
    r = geometry.skin_radius_mm
    chart = equal_area(sphere_points(geometry, tips_px, r - length_pitches * pitch), r)
    # The radius of the circle on the chart of equal area.
    reach = 2 * r * math.sin(math.radians(geometry.visible_half_angle_deg) / 2)
    # Towards the rim lattices widen, which the fit finds afterwards.
    chart = chart[np.linalg.norm(chart, axis=1) < 0.62 * reach]
    if len(chart) < 12:
        return None
    tree = cKDTree(chart)
    steps = np.concatenate([chart[tree.query_ball_point(p, 1.9 * pitch)] - p for p in chart])
    # Not the difference of a point with itself.
    steps = steps[np.linalg.norm(steps, axis=1) > 0.4 * pitch]
    if len(steps) < 24:
        return None
    # The places where differences are densest, the shortest first.
    # Differences to neighbours repeat on a lattice, and scatter otherwise.
    support = np.array([len(q) for q in cKDTree(steps).query_ball_point(steps, 0.16 * pitch)])
    strong = steps[support > 0.45 * support.max()]
    strong = strong[np.argsort(np.linalg.norm(strong, axis=1))]
    a = _centre(steps, strong[0], 0.2 * pitch)
    # The second step must not be a multiple of the first.
    across = (
        np.abs(a[0] * strong[:, 1] - a[1] * strong[:, 0])
        / np.linalg.norm(a)
        / np.linalg.norm(strong, axis=1)
    )
    if not (across > 0.7).any():
        return None
    b = _centre(steps, strong[np.argmax(across > 0.7)], 0.2 * pitch)
    # Either sign spans the lattice; this one makes the result unique.
    b = b if a @ b >= 0 else -b
    first = int(np.argmin(np.linalg.norm(chart, axis=1)))
    # From neighbour to neighbour, because errors of the steps would add up over many of them.
    index, queue = {first: (0, 0)}, [first]
    while queue:
        k = queue.pop(0)
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            far, q = tree.query(chart[k] + di * a + dj * b)
            if far < 0.28 * pitch and int(q) not in index:
                index[int(q)] = (index[k][0] + di, index[k][1] + dj)
                queue.append(int(q))
    # Of fewer, chance makes lattices too.
    if len(index) < 10:
        return None
    columns = np.column_stack((np.ones(len(index)), np.array(list(index.values()), float)))
    coefficients = np.linalg.lstsq(columns, chart[list(index)], rcond=None)[0]
    return Lattice(np.append(coefficients.ravel(), 0.0))


def _centre(steps: F64, at: F64, within: float) -> F64:
    for _ in range(4):
        at = steps[np.linalg.norm(steps - at, axis=1) < within].mean(axis=0)
    return at
