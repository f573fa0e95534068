"""Sensors of another model, never trained on: square lattice, mushroom pins, a skin with two decay lengths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from tacshade_edge.simulator import render
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedFrame
from tacshade_edge.simulator.skin import Skin, direction_to_chart, press_skin
from tacshade_edge.types import U8

_CORNERS = 12


class OtherRenderer(render.Renderer):
    """Markers in the middles of square cells; pins with a thin stem and a wide cap."""

    def __init__(self, model: SensorModel) -> None:
        super().__init__(model)
        self.print = _square_print(model)

    def _features(self, skin: Skin) -> U8:
        model, marks = self.model, self.print
        size = (model.image_height_px * 2, model.image_width_px * 2)
        ground, white, black = (
            round(255 * v) for v in (model.skin_reflectance, model.marker_reflectance, model.pin_reflectance)
        )
        canvas = np.full(size, ground, np.uint8)
        smooth = render._smoothed(skin, float(np.mean(marks.pin_base_mm)))
        outline = render._on_skin(skin, *render._carried(smooth, marks.marker_chart_mm, model.friction))
        for polygon in render._to_canvas(render.project(model.geometry, outline)):
            cv2.fillConvexPoly(canvas, polygon, white, cv2.LINE_8, 4)
        base, tip = (
            render._to_canvas(render.project(model.geometry, c))
            for c in render._pin_corners(skin, smooth, marks, model.friction)
        )
        stem_marks = replace(marks, pin_tip_mm=0.7 * marks.pin_base_mm)
        stem = render._to_canvas(
            render.project(model.geometry, render._pin_corners(skin, smooth, stem_marks, model.friction)[1])
        )
        for polygon in np.concatenate((base, stem), axis=1):
            cv2.fillConvexPoly(canvas, cv2.convexHull(polygon), black, cv2.LINE_8, 4)
        for polygon in tip:
            cv2.fillConvexPoly(canvas, polygon, black, cv2.LINE_8, 4)
        return np.asarray(
            cv2.resize(canvas, (model.image_width_px, model.image_height_px), interpolation=cv2.INTER_AREA)
        )


class OtherSensor:
    """As `SimulatedSensor`, of the other model."""

    def __init__(self, model: SensorModel) -> None:
        self.model = model
        self._renderer = OtherRenderer(model)

    def frame(self, presses: Sequence[Press] = (), noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture."""
        skin = two_scale_skin(self.model, tuple(presses))
        return SimulatedFrame(
            self._renderer.expose(self._renderer.draw(skin), noise_seed), tuple(presses), skin, self.model
        )


def other_model(seed: int) -> SensorModel:
    """Draw a sensor; its caps are wide, so that contact brightens it."""
    rng = np.random.default_rng((seed, 13))
    return replace(
        random_model(seed),
        pin_tip_radius_pitches=float(rng.uniform(0.36, 0.40)),
        pin_base_radius_pitches=float(rng.uniform(0.18, 0.24)),
        marker_radius_pitches=float(rng.uniform(0.40, 0.50)),
    )


def two_scale_skin(model: SensorModel, presses: Sequence[Press]) -> Skin:
    """The mean of two skins: a stiff surface over a soft depth, whose skirt is no exponential."""
    near = press_skin(model.skin_radius_mm, 0.5 * model.skin_decay_mm, presses)
    far = press_skin(model.skin_radius_mm, 1.8 * model.skin_decay_mm, presses)
    mixed = np.asarray(0.55 * near.height_mm + 0.45 * far.height_mm, np.float32)
    return Skin(near.radius_mm, near.step_mm, mixed, near.obstacle_mm)


def _square_print(model: SensorModel) -> render.Print:
    rng = np.random.default_rng((model.print_seed, 14))
    r, p = model.skin_radius_mm, model.pitch_mm
    limit = 2 * r * math.sin(math.radians(model.visible_half_angle_deg + 6) / 2)
    n = math.ceil(limit / p) + 1
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    a = math.radians(model.lattice_rotation_deg)
    turn = np.array(((math.cos(a), math.sin(a)), (-math.sin(a), math.cos(a))))

    def lay(shift: float) -> np.ndarray:
        points = (np.stack((i.ravel(), j.ravel()), axis=1) + shift) * p @ turn
        points = points + rng.normal(0, model.position_tolerance_mm, points.shape)
        return points[np.linalg.norm(points, axis=1) < limit]

    def sizes(pitches: float, count: int) -> np.ndarray:
        return pitches * p * np.clip(1 + model.size_tolerance * rng.standard_normal(count), 0.5, 1.5)

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
