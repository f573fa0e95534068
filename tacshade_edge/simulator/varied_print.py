"""Pins and markers that are not the simulator's: any lattice with a marker in each cell's middle, pins with a waist."""

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
    """Radius at `height` (0 the base, 1 the tip) as a part of the frustum's there; `cap`: a stem under a flat cap."""

    height: float
    part: float
    cap: bool = False


class VariedRenderer(render.Renderer):
    """Draws pins of another profile, and any print."""

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
            corners = render._pin_corners(skin, smooth, at, model.friction)
            base, tip = (render._to_canvas(render.project(model.geometry, c)) for c in corners)
            return base, tip

        outline = render._on_skin(skin, *render._carried(smooth, marks.marker_chart_mm, model.friction))
        fill(render._to_canvas(render.project(model.geometry, outline)), white)
        base, tip = pins(marks)
        at = self._profile.height
        frustum = (1 - at) * marks.pin_base_mm + at * marks.pin_tip_mm
        radius = self._profile.part * (marks.pin_base_mm if self._profile.cap else frustum)
        waist = pins(replace(marks, pin_tip_mm=radius, pin_length_mm=at * marks.pin_length_mm))[1]
        fill(np.concatenate((base, waist), axis=1), black)
        fill(tip if self._profile.cap else np.concatenate((waist, tip), axis=1), black)
        if tip_level != black:
            fill(tip, tip_level)
        return np.asarray(
            cv2.resize(canvas, (model.image_width_px, model.image_height_px), interpolation=cv2.INTER_AREA)
        )


def lattice_print(model: SensorModel, angle_deg: float, ratio: float = 1.0) -> render.Print:
    """Lay pins on a lattice of any angle and ratio of its sides, a marker in the middle of each cell."""
    rng = np.random.default_rng((model.print_seed, 14))
    r, p = model.skin_radius_mm, model.pitch_mm
    limit = 2 * r * math.sin(math.radians(model.visible_half_angle_deg + 6) / 2)
    n = 2 * math.ceil(limit / p) + 2
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    a, b = math.radians(model.lattice_rotation_deg), math.radians(angle_deg)
    sides = np.array(((1.0, 0.0), (ratio * math.cos(b), ratio * math.sin(b)))) / math.sqrt(ratio)
    cell = p * sides @ np.array(((math.cos(a), math.sin(a)), (-math.sin(a), math.cos(a))))

    def lay(shift: float) -> F64:
        points = (np.stack((i.ravel(), j.ravel()), axis=1) + shift) @ cell
        points = points + rng.normal(0, model.position_tolerance_mm, points.shape)
        return np.asarray(points[np.linalg.norm(points, axis=1) < limit])

    def sizes(pitches: float, count: int) -> F64:
        return np.asarray(pitches * p * np.clip(1 + model.size_tolerance * rng.standard_normal(count), 0.5, 1.5))

    pins, markers = lay(0.0), lay(0.5)
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
