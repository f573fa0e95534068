"""Pins and markers unlike the simulator's: any lattice, a marker in each cell, pins with any outline."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.simulator import render
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.skin import Skin, direction_to_chart
from tacshade_edge.types import F64, U8

_CORNERS = 12


@dataclass(frozen=True, slots=True)
class PinProfile:
    """The pin's outline between base and tip, as cones between rings.

    Attributes
    ----------
    rings : tuple of (height, of base, of tip)
        Each ring's height (0 at the base, 1 at the tip) and its radius, the sum of a part of the base's radius and a
        part of the tip's.
    """

    rings: tuple[tuple[float, float, float], ...]

    @classmethod
    def waist(cls, height: float, part: float) -> PinProfile:
        """Make a frustum whose radius at a height is multiplied by `part`, which gives a waist or a belly."""
        return cls(((height, part * (1 - height), part * height),))


class VariedRenderer(render.Renderer):
    """Draws pins with another profile, and any print."""

    def __init__(self, model: SensorModel, marks: render.Print | None, profile: PinProfile) -> None:
        super().__init__(model)
        if marks is not None:
            self.print = marks
        self._profile = profile

    def _features(self, skin: Skin) -> U8:
        model, marks = self.model, self.print
        size = (model.image_height_px * 2, model.image_width_px * 2)
        ground, white, black, tip_level = (
            round(255 * v)
            for v in (
                model.skin_reflectance,
                model.marker_reflectance,
                model.pin_reflectance,
                model.pin_tip_reflectance,
            )
        )
        canvas = np.full(size, ground, np.uint8)
        smooth = render._smoothed(skin, float(np.mean(marks.pin_base_mm)))

        def fill(polygons: np.ndarray, level: int) -> None:
            for polygon in polygons:
                cv2.fillConvexPoly(canvas, cv2.convexHull(polygon), level, cv2.LINE_8, 4)

        def pins(at: render.Print) -> tuple[np.ndarray, np.ndarray]:
            corners = render._pin_corners(skin, smooth, at, model)
            base, tip = (render._to_canvas(render.project(model.geometry, c)) for c in corners)
            return base, tip

        outline = render._on_skin(skin, *render._carried(smooth, marks.marker_chart_mm, model.friction))
        fill(render._to_canvas(render.project(model.geometry, outline)), white)
        below, tip = pins(marks)
        for height, of_base, of_tip in self._profile.rings:
            radius = of_base * marks.pin_base_mm + of_tip * marks.pin_tip_mm
            ring = pins(replace(marks, pin_tip_mm=radius, pin_length_mm=height * marks.pin_length_mm))[1]
            fill(np.concatenate((below, ring), axis=1), black)
            below = ring
        fill(np.concatenate((below, tip), axis=1), black)
        if tip_level != black:
            fill(tip, tip_level)
        return np.asarray(
            cv2.resize(canvas, (model.image_width_px, model.image_height_px), interpolation=cv2.INTER_AREA)
        )


def lattice_print(model: SensorModel, angle_deg: float, ratio: float = 1.0) -> render.Print:
    """Place pins on a lattice with any angle and ratio of sides, and a marker in the middle of each cell."""
    n = 2 * math.ceil(reach_mm(model) / model.pitch_mm) + 2
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    a, b = math.radians(model.lattice_rotation_deg), math.radians(angle_deg)
    sides = np.array(((1.0, 0.0), (ratio * math.cos(b), ratio * math.sin(b)))) / math.sqrt(ratio)
    cell = model.pitch_mm * sides @ np.array(((math.cos(a), math.sin(a)), (-math.sin(a), math.cos(a))))
    corners = np.stack((i.ravel(), j.ravel()), axis=1)
    return print_at(model, corners @ cell, (corners + 0.5) @ cell)


def reach_mm(model: SensorModel) -> float:
    """Compute how far from the apex the print reaches, in the equal-area chart."""
    return 2 * model.skin_radius_mm * math.sin(math.radians(model.visible_half_angle_deg + 6) / 2)


def print_at(model: SensorModel, pins_mm: F64, markers_mm: F64) -> render.Print:
    """Print pins and markers at points (N, 2) of the equal-area chart, with the model's tolerances."""
    rng = np.random.default_rng((model.print_seed, 14))
    r, p, limit = model.skin_radius_mm, model.pitch_mm, reach_mm(model)

    def lay(points: F64) -> F64:
        points = points + rng.normal(0, model.position_tolerance_mm, points.shape)
        return np.asarray(points[np.linalg.norm(points, axis=1) < limit])

    def sizes(pitches: float, count: int) -> F64:
        return np.asarray(pitches * p * np.clip(1 + model.size_tolerance * rng.standard_normal(count), 0.5, 1.5))

    pins, markers = lay(pins_mm), lay(markers_mm)
    centre = render._equal_area_to_direction(markers, r)
    east, north = render._tangents(centre)
    angles = np.arange(_CORNERS) * (2 * math.pi / _CORNERS)
    radius = sizes(model.marker_radius_pitches, len(markers))[:, None, None]
    ring = centre[:, None, :] * r + radius * (
        np.cos(angles)[None, :, None] * east[:, None, :] + np.sin(angles)[None, :, None] * north[:, None, :]
    )
    return render.Print(
        marker_chart_mm=np.stack(direction_to_chart(ring, r), axis=-1),
        pin_chart_mm=np.stack(direction_to_chart(render._equal_area_to_direction(pins, r), r), axis=-1),
        pin_base_mm=sizes(model.pin_base_radius_pitches, len(pins)),
        pin_tip_mm=sizes(model.pin_tip_radius_pitches, len(pins)),
        pin_length_mm=sizes(model.pin_length_pitches, len(pins)),
    )
