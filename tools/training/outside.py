"""Sensors and presses as users have them: wide plates, soft domes,
patterns that end before the rim, any camera.

Most are TacTips with short pins, like most sensors in use. Each skin is solved once, because that
takes the most time, and seen by several sensors with different prints, cameras and light.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from tacshade_edge.lab.fitting.twin import on_dome
from tacshade_edge.lab.simulator.render import PinProfile, Print, Renderer, print_features
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model, tactip
from tacshade_edge.lab.simulator.skin import chart_to_direction
from tacshade_edge.types import F64, U8
from tools.testbed.simulator.families import lattice_print
from tools.training.varied import pin_outline, varied_print

VIEWS = 3
"""Number of sensors that see each skin."""

TACTIP_PART, PARTLY_PRINTED_PART, RINGED_PART, VIGNETTED_PART, PLATE_PART = (
    0.7,
    0.5,
    0.25,
    0.25,
    0.5,
)
SIZES = ((240, 320), (480, 640), (120, 160), (128, 128))
SIZE_SHARES = (0.56, 0.12, 0.16, 0.16)

CIRCLE_AT_PRINT_PART = 0.7
"""Among the sensors whose print ends before the rim,
the share that is calibrated with the print's circle.
"""
CIRCLE_DEVIATION = 0.02
"""Standard deviation of the logarithm of a found circle's radius."""

Camera = Callable[[U8], U8]
"""Processes a picture before the program receives it."""


def soft_dome(seed: int) -> SensorModel:
    """Draw a sensor's mechanics: decay lengths from a pitch to the whole dome, sway,
    a gel that keeps its volume.
    """
    rng = np.random.default_rng((seed, 21))

    def draw(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    def spread(low: float, high: float) -> float:
        return math.exp(draw(math.log(low), math.log(high)))

    return replace(
        random_model(seed),
        skin_decay_mm=spread(1.3, 8.0),
        friction=draw(0.3, 1.0),
        drag_decay_mm=spread(2.0, 16.0),
        coulomb=spread(0.5, 10.0),
        sway=draw(0.0, 0.8),
        bulge=draw(0.0, 1.0) if rng.random() < 0.6 else 0.0,
        pin_lag=draw(0.0, 0.4),
    )


def printed(dome: SensorModel, seed: int) -> SensorModel:
    """Draw print, camera and light of a sensor with this dome."""
    rng = np.random.default_rng((seed, 22))

    def draw(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    height, width = SIZES[rng.choice(len(SIZES), p=SIZE_SHARES)]
    look = random_model(seed, height, width)
    model = replace(
        on_dome(look, dome),
        camera_distance_mm=None if rng.random() < 0.08 else look.camera_distance_mm,
        lattice_rotation_deg=draw(0.0, 180.0),
        vignetting=draw(0.5, 0.85) if rng.random() < VIGNETTED_PART else draw(0.05, 0.5),
        blur_px=draw(0.3, 1.0),
    )
    if rng.random() >= TACTIP_PART:
        return replace(
            model,
            pitch_mm=draw(1.4, 2.8),
            pin_length_pitches=draw(0.8, 2.1),
            pin_tip_radius_pitches=draw(0.22, 0.42),
            pin_base_radius_pitches=draw(0.18, 0.36),
            marker_radius_pitches=draw(0.33, 0.52),
        )
    tip = draw(0.12, 0.40)  # from a twentieth to half of the skin is white
    return replace(
        tactip(model),
        pitch_mm=draw(1.4, 3.6),
        pin_length_pitches=draw(0.3, 1.1),
        pin_tip_radius_pitches=tip,
        pin_base_radius_pitches=tip * draw(0.8, 1.2),
        skin_reflectance=(ground := draw(0.02, 0.2)),
        marker_reflectance=ground,
        pin_reflectance=ground * draw(0.7, 1.0),
        pin_tip_reflectance=draw(0.6, 0.98),
    )


class OutsideRenderer(Renderer):
    """Draws a print that may end before the rim,
    perhaps under a ring of LEDs that the camera sees.
    """

    def __init__(self, model: SensorModel, rng: np.random.Generator) -> None:
        profile = PinProfile(()) if rng.random() < 0.6 else pin_outline(rng)
        super().__init__(model, _any_print(model, rng), profile)
        self.printed_part = 1.0
        if rng.random() < PARTLY_PRINTED_PART:
            self.printed_part = float(rng.uniform(0.6, 1.0))
            self.print = _inner_part(self.print, model, self.printed_part)
        if rng.random() < RINGED_PART:
            self._glints = self._glints + _leds(model, rng)


def camera(rng: np.random.Generator) -> Camera:
    """Draw a camera: most return the picture as it is, some a picture with only two grey levels."""
    kind, level = rng.random(), float(rng.uniform(60, 130))
    part, offset = float(rng.uniform(0.06, 0.2)), float(rng.uniform(-25, -3))
    if kind < 0.7:
        return lambda image: image
    if kind < 0.8:
        return lambda image: np.where(image > level, 255, 0).astype(np.uint8)

    def adaptive(image: U8) -> U8:
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        window = 2 * round(part / 2 * min(grey.shape)) + 3
        white = cv2.adaptiveThreshold(
            grey, 255, cv2.ADAPTIVE_THRESH_GAUSSIAN_C, cv2.THRESH_BINARY, window, offset
        )
        return np.asarray(white if image.ndim == 2 else cv2.merge((white, white, white)), np.uint8)

    return adaptive


def _any_print(model: SensorModel, rng: np.random.Generator) -> Print:
    kind = rng.random()
    if kind < 0.45:
        return print_features(model)
    if kind < 0.8:
        return lattice_print(model, float(rng.uniform(50, 90)), float(rng.uniform(1.0, 1.25)))
    return varied_print(model, rng)


def _inner_part(marks: Print, model: SensorModel, part: float) -> Print:
    """Keep the pins and markers within a part of the visible circle."""
    most = math.sin(math.radians(model.visible_half_angle_deg)) * part

    def inside(chart_mm: F64) -> np.typing.NDArray[np.bool_]:
        direction = chart_to_direction(chart_mm[:, 0], chart_mm[:, 1], model.skin_radius_mm)
        return np.asarray(
            (np.hypot(direction[:, 0], direction[:, 1]) < most) & (direction[:, 2] > 0)
        )

    pins = inside(marks.pin_chart_mm)
    return Print(
        marker_chart_mm=marks.marker_chart_mm[inside(marks.marker_chart_mm.mean(axis=1))],
        pin_chart_mm=marks.pin_chart_mm[pins],
        pin_base_mm=marks.pin_base_mm[pins],
        pin_tip_mm=marks.pin_tip_mm[pins],
        pin_length_mm=marks.pin_length_mm[pins],
    )


def found_circle(printed_part: float, rng: np.random.Generator) -> float:
    """Draw the radius of the circle with which a sensor is calibrated,
    as part of the visible circle's.

    `calibrate` finds the circle by the pattern. Where the print ends before the rim, it often finds
    the print's circle, and presses then move pins out of this circle.
    """
    part = printed_part if rng.random() < CIRCLE_AT_PRINT_PART else 1.0
    return min(1.0, part * math.exp(float(rng.normal(0, CIRCLE_DEVIATION))))


def _leds(model: SensorModel, rng: np.random.Generator) -> np.typing.NDArray[np.float32]:
    """Draw LEDs in a ring at the rim of the visible circle, blurred by the camera's lens."""
    rows, cols = np.mgrid[: model.image_height_px, : model.image_width_px].astype(np.float32)
    image = np.zeros(rows.shape, np.float32)
    ring, size = (
        float(rng.uniform(0.95, 1.15)),
        float(rng.uniform(0.015, 0.05)) * model.disc_radius_px,
    )
    count, turn, grey = (
        int(rng.integers(4, 17)),
        float(rng.uniform(0, 7)),
        float(rng.uniform(100, 255)),
    )
    for angle in turn + np.arange(count) * (2 * math.pi / count):
        row = model.row_c + ring * model.disc_radius_px * math.sin(angle)
        col = model.col_c + ring * model.disc_radius_px * math.cos(angle)
        image += grey * np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / (2 * size * size))
    return image
