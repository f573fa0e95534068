"""The layered family: a rubber skin on a thick, nearly incompressible gel with a free rim,
through a fisheye lens.

Its prints are white pins on a jittered hexagonal lattice or on a spiral,
or dark pins among white rings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.types import F64
from tools.studies.strangers import lattices
from tools.studies.strangers.camera import HEIGHT_PX, WIDTH_PX, Camera
from tools.studies.strangers.paths import Dome
from tools.studies.strangers.picture import (
    Exposure,
    Light,
    Markers,
    Painter,
    Pins,
    visible_part,
)
from tools.studies.strangers.solved import Solved

Spans = dict[str, tuple[float, float]]
RANGES: dict[str, Spans] = {
    "working": {
        "radius_mm": (17.0, 21.0),
        "skin_mm": (1.4, 2.2),
        "gel_part": (0.5, 0.58),
        "stiffness_ratio": (2.0, 6.0),
        "friction": (0.45, 0.8),
    },
    "final": {
        "radius_mm": (20.0, 25.0),
        "skin_mm": (1.0, 1.6),
        "gel_part": (0.46, 0.54),
        "stiffness_ratio": (5.0, 10.0),
        "friction": (0.35, 0.65),
    },
}
"""Ranges of `LayeredSkin`. Nobody evaluates anything on ``final`` before the work is done."""
FIRST_SEED = {"working": 41000, "final": 49100}
DEEPEST_MM = 3.2
"""Greatest depth on a skin of 20 mm."""
PRINTS = ("hexagonal", "spiral", "ringed", "hexagonal")
"""Of the sensors in turn."""


@dataclass(frozen=True, slots=True)
class LayeredSkin:
    """A skin on its gel, which is bonded to a stiff core."""

    radius_mm: float
    skin_mm: float
    gel_part: float  # thickness of the gel as a part of the radius
    stiffness_ratio: float  # Young's modulus of the skin over that of the gel, which is 1
    friction: float

    @property
    def dome(self) -> Dome:
        """What paths need."""
        return Dome(
            self.radius_mm, lambda x, y: math.sqrt(self.radius_mm**2 - x * x - y * y), DEEPEST_MM
        )


def drawn(range_name: str, number: int) -> LayeredSkin:
    """Draw the skin of a sensor."""
    rng = np.random.default_rng((FIRST_SEED[range_name] + number, 71))
    return LayeredSkin(**{k: float(rng.uniform(*span)) for k, span in RANGES[range_name].items()})


def layered(range_name: str, number: int, states: Path) -> Solved:
    """Make a sensor; its states may still be missing."""
    skin, seed = drawn(range_name, number), FIRST_SEED[range_name] + number
    rng = np.random.default_rng((seed, 72))
    draw = drawing(rng)
    half_angle_deg, distance_mm = draw(42.0, 50.0), draw(5.0, 14.0)
    camera = fisheye(rng, skin.radius_mm, half_angle_deg, distance_mm)
    kind = PRINTS[number % len(PRINTS)]
    pins, markers = _print(rng, kind, skin.radius_mm, half_angle_deg)
    level, falloff = draw(150.0, 220.0), draw(0.25, 0.5)
    exposure = Exposure(
        blur_px=draw(1.0, 1.6),
        read_noise_grey=draw(1.5, 3.0),
        shot_noise_grey=draw(2.0, 5.0),
        colour_bgr=(draw(0.8, 1.1), 1.0, draw(0.85, 1.1)),
    )
    painter = Painter(
        camera=camera,
        pins=pins,
        markers=markers,
        ground=draw(0.08, 0.15),
        white=draw(0.85, 0.95),
        light=Light(level, falloff=falloff),
        exposure=exposure,
        inside=visible_part(camera, half_angle_deg, skin.radius_mm),
    )
    stated = StatedSensor(
        skin.radius_mm, distance_mm, half_angle_deg, "bright" if kind == "ringed" else "dark"
    )

    def rest(direction: F64) -> F64:
        return np.full(direction.shape[:-1], skin.radius_mm)

    return Solved(stated, skin.dome, rest, painter, seed, states, range_name, number)


def drawing(rng: np.random.Generator) -> Callable[[float, float], float]:
    return lambda low, high: float(rng.uniform(low, high))


def fisheye(
    rng: np.random.Generator, radius_mm: float, half_angle_deg: float, distance_mm: float
) -> Camera:
    """Draw a lens through which the visible circle has a usual size."""
    draw = drawing(rng)
    disc_px, distortion = HEIGHT_PX * draw(0.38, 0.45), draw(-0.25, 0.05)
    theta = math.radians(half_angle_deg)
    angle = math.atan2(radius_mm * math.sin(theta), distance_mm + radius_mm * math.cos(theta))
    slack_px = HEIGHT_PX / 2 - disc_px
    return Camera(
        "fisheye",
        distance_mm,
        disc_px / (angle + distortion * angle**3),
        (HEIGHT_PX - 1) / 2 + 0.6 * slack_px * draw(-1, 1),
        (WIDTH_PX - 1) / 2 + 0.6 * slack_px * draw(-1, 1),
        distortion,
    )


def _print(
    rng: np.random.Generator, kind: str, radius_mm: float, half_angle_deg: float
) -> tuple[Pins, Markers | None]:
    draw = drawing(rng)
    pitch_mm, far = draw(1.8, 2.6) * radius_mm / 20, lattices.reach(half_angle_deg)
    pitch, turn = pitch_mm / radius_mm, draw(0, 1.0)
    places, middles = lattices.hexagonal(pitch, far, turn)
    if kind == "spiral":
        places = lattices.spiral(pitch, far, turn)
    direction = lattices.on_sphere(places, far, draw(0.03, 0.07) * pitch, rng)
    count = len(direction)
    if kind != "ringed":
        tip_mm = draw(0.26, 0.32) * pitch_mm * rng.normal(1, 0.04, count)
        length_mm = np.full(count, draw(0.7, 1.3) * pitch_mm)
        return Pins(direction, 0.9 * tip_mm, tip_mm, length_mm, draw(0, 0.1), 0.1, 0.95), None
    tip_mm = draw(0.28, 0.34) * pitch_mm * rng.normal(1, 0.04, count)
    length_mm = np.full(count, draw(1.0, 1.5) * pitch_mm)
    pins = Pins(direction, 0.8 * tip_mm, tip_mm, length_mm, draw(0, 0.1), 0.07, 0.07)
    centre = lattices.on_sphere(middles, far, 0.03 * pitch, rng)
    outer_mm = np.full(len(centre), draw(0.36, 0.4) * pitch_mm)
    return pins, Markers(centre, outer_mm, draw(0.3, 0.4) * outer_mm)
