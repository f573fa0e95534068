"""A solved skin as a smooth surface, and what each pixel of a camera sees of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CloughTocher2DInterpolator, LinearNDInterpolator
from scipy.spatial import Delaunay

from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.skin import chart_to_direction, direction_to_chart
from tacshade_edge.lab.studies.evaluate.score import KnownTruth, between_pixels
from tacshade_edge.types import F32, F64
from tools.studies.strangers.camera import HEIGHT_PX, WIDTH_PX, Camera

RestMm = Callable[[F64], F64]
"""The distance (...,) from O of the untouched skin in unit directions (..., 3)."""

TOUCHING_MM = 0.06
"""Skin nearer to the object than this counts as touching:
so far off it lies between touching points of the mesh.
"""
STEP_MM, BEYOND_DEG = 0.35, 7.0
"""Step of the grid on the skin, and how far it reaches beyond the visible part."""


class Surface:
    """Material points of a skin; they are named by their direction from O in the untouched skin."""

    def __init__(self, rest_mm: F64, at_mm: F64, rest: RestMm) -> None:
        chart = np.stack(direction_to_chart(rest_mm, 1.0), axis=-1)
        self._rest = rest
        self._moved = CloughTocher2DInterpolator(chart, at_mm - rest_mm)

    def points(self, direction: F64) -> F64:
        """Where material points are now, (..., 3) in mm."""
        chart = np.stack(direction_to_chart(direction, 1.0), axis=-1)
        return np.asarray(
            direction * self._rest(direction)[..., None] + np.nan_to_num(self._moved(chart))
        )

    def moved(self, direction: F64) -> F64:
        """By how much material points have moved, (..., 3) in mm."""
        return self.points(direction) - direction * self._rest(direction)[..., None]

    def normals(self, direction: F64, apart: float = 0.02) -> F64:
        """Outward unit normals (..., 3) of the skin around material points,
        over an angle in radians.
        """
        x, y = direction_to_chart(direction, 1.0)
        across = [
            self.points(chart_to_direction(x + apart * i, y + apart * j, 1.0))
            - self.points(chart_to_direction(x - apart * i, y - apart * j, 1.0))
            for i, j in ((1, 0), (0, 1))
        ]
        normal = np.cross(across[0], across[1])
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What pixels inside the visible circle see: maps (H, W,
    3) of points in mm and of unit normals, NaN outside.
    """

    points_mm: F32
    normals: F32


def seen(surface: Surface, camera: Camera, half_angle_deg: float, radius_mm: float) -> View:
    """Find what every pixel sees of a skin whose visible part ends at an angle from the tip."""
    reach = 2 * math.tan(math.radians(half_angle_deg + BEYOND_DEG) / 2)
    count = math.ceil(reach * radius_mm / STEP_MM)
    axis = np.linspace(-reach, reach, 2 * count + 1)
    x, y = np.meshgrid(axis, axis)
    inside = np.hypot(x, y) <= reach
    direction = chart_to_direction(x, y, 1.0)
    points = surface.points(direction)
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    values = np.concatenate((points[inside], normal[inside]), axis=1)
    maps = LinearNDInterpolator(Delaunay(camera.project(points[inside])), values)
    rows, cols = np.mgrid[:HEIGHT_PX, :WIDTH_PX]
    found = np.full((HEIGHT_PX, WIDTH_PX, 6), np.nan, np.float32)
    rim = camera.project(points[inside])
    low, high = np.floor(rim.min(axis=0)), np.ceil(rim.max(axis=0))
    window = (
        slice(max(int(low[1]), 0), int(high[1]) + 1),
        slice(max(int(low[0]), 0), int(high[0]) + 1),
    )
    found[window] = maps(cols[window], rows[window])
    return View(found[..., :3], found[..., 3:])


def truth(
    view: View,
    inside: np.typing.NDArray[np.bool_],
    press: Press | None,
    radius_mm: float,
    rest: RestMm,
) -> KnownTruth:
    """Measure the heights of a skin, inwards from the untouched one,
    and where it touches an object.

    True points lie on the stated sphere less the height, as points of a result do.
    """
    points = view.points_mm.astype(np.float64)
    known = inside & np.isfinite(points[..., 0])
    far = np.linalg.norm(points[known], axis=1)
    direction = points[known] / far[:, None]
    height = np.maximum(rest(direction) - far, 0)
    height_map = np.full(inside.shape, np.nan, np.float32)
    height_map[known] = height
    contact = np.zeros(inside.shape, bool)
    if press is not None:
        contact[known] = press.distance_mm(radius_mm, points[known]) <= TOUCHING_MM
    placed = np.zeros((*inside.shape, 3), np.float32)
    placed[known] = direction * (radius_mm - height)[:, None]
    touching = between_pixels(placed[contact], contact) if contact.any() else placed[contact]
    return KnownTruth(touching, float(height.max(initial=0)), contact, height_mm=height_map)
