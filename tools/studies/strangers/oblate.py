"""The oblate family: a thin shell, flatter at the tip than a sphere, on a gel that flows;
its pins bend.

A tilted pinhole camera looks at it in the light of a few LEDs beside the lens, which fades across
the skin and is mirrored by it. The prints are dark pins among white dots on concentric rings, and
white pins on rings or a spiral.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.types import F64, Polarity
from tools.studies.strangers import lattices
from tools.studies.strangers.camera import HEIGHT_PX, WIDTH_PX, Camera
from tools.studies.strangers.layered import Spans, drawing
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

RANGES: dict[str, Spans] = {
    "working": {
        "radius_mm": (17.0, 21.0),
        "flatness": (0.68, 0.8),
        "thickness_mm": (0.9, 1.3),
        "gel_per_mm": (0.04, 0.08),
        "gel_along": (0.3, 0.6),
        "friction": (0.4, 0.8),
    },
    "final": {
        "radius_mm": (19.0, 23.0),
        "flatness": (0.6, 0.72),
        "thickness_mm": (1.1, 1.6),
        "gel_per_mm": (0.03, 0.055),
        "gel_along": (0.2, 0.45),
        "friction": (0.6, 1.0),
    },
}
"""Ranges of `OblateSkin`. Nobody evaluates anything on ``final`` before the work is done."""
FIRST_SEED = {"working": 51000, "final": 59100}
HALF_ANGLE_DEG = (42.0, 48.0)
DEEPEST_MM = 3.0
"""Greatest depth on a skin of 20 mm."""
PRINTS = ("dark rings", "white rings", "dark rings", "white spiral")
"""Of the sensors in turn."""


@dataclass(frozen=True, slots=True)
class OblateSkin:
    """An ellipsoid through the tip and the visible rim of the stated sphere.

    Stresses are in units of the rubber's shear modulus.
    """

    radius_mm: float  # of the stated sphere
    half_angle_deg: float  # of its visible part
    flatness: float  # the ellipsoid's axis along z as a part of those across
    thickness_mm: float
    gel_per_mm: float  # stiffness of the gel per area, across the skin
    gel_along: float  # that along the skin as a part of it
    friction: float

    @property
    def across_mm(self) -> float:
        """The half axis across z."""
        theta = math.radians(self.half_angle_deg)
        low = 1 - math.cos(theta)
        both = math.sin(theta) ** 2 + (low / self.flatness) ** 2
        return self.flatness * self.radius_mm * both / (2 * low)

    @property
    def middle_mm(self) -> float:
        """The z of the ellipsoid's middle."""
        return self.radius_mm - self.flatness * self.across_mm

    def rest_mm(self, direction: F64) -> F64:
        """The distance (...,) of the untouched skin from O in unit directions (..., 3)."""
        out, up = self.across_mm, self.flatness * self.across_mm
        flat = (direction[..., 0] ** 2 + direction[..., 1] ** 2) / out**2
        square = flat + (direction[..., 2] / up) ** 2
        half = direction[..., 2] * self.middle_mm / up**2
        rest = (self.middle_mm / up) ** 2 - 1
        return np.asarray((half + np.sqrt(half**2 - square * rest)) / square)

    def surface_z(self, x_mm: float, y_mm: float) -> float:
        """The z of the untouched skin."""
        far = (x_mm**2 + y_mm**2) / self.across_mm**2
        return self.middle_mm + self.flatness * self.across_mm * math.sqrt(1 - far)


def drawn(range_name: str, number: int) -> OblateSkin:
    """Draw the skin of a sensor."""
    rng = np.random.default_rng((FIRST_SEED[range_name] + number, 71))
    half_angle_deg = float(rng.uniform(*HALF_ANGLE_DEG))
    values = {k: float(rng.uniform(*span)) for k, span in RANGES[range_name].items()}
    return OblateSkin(half_angle_deg=half_angle_deg, **values)


def oblate(range_name: str, number: int, states: Path) -> Solved:
    """Make a sensor; its states may still be missing."""
    skin, seed = drawn(range_name, number), FIRST_SEED[range_name] + number
    rng = np.random.default_rng((seed, 72))
    draw = drawing(rng)
    distance_mm = draw(10.0, 24.0)
    theta = math.radians(skin.half_angle_deg)
    camera = _tilted(rng, skin.radius_mm, theta, distance_mm)
    kind = PRINTS[number % len(PRINTS)]
    pins, markers = _print(rng, kind, skin)
    exposure = Exposure(
        blur_px=draw(0.5, 1.0),
        read_noise_grey=draw(1.0, 2.5),
        shot_noise_grey=draw(1.0, 4.0),
        colour_bgr=(draw(0.95, 1.15), 1.0, draw(0.75, 0.95)),
    )
    rim_mm = float(skin.rest_mm(np.array((math.sin(theta), 0.0, math.cos(theta)))))
    painter = Painter(
        camera=camera,
        pins=pins,
        markers=markers,
        ground=draw(0.08, 0.15),
        white=draw(0.85, 0.95),
        light=_light(rng, skin.radius_mm, distance_mm),
        exposure=exposure,
        inside=visible_part(camera, skin.half_angle_deg, rim_mm),
    )
    polarity: Polarity = "bright" if kind.startswith("dark") else "dark"
    stated = StatedSensor(skin.radius_mm, distance_mm, skin.half_angle_deg, polarity)
    dome = Dome(skin.radius_mm, skin.surface_z, DEEPEST_MM)
    return Solved(stated, dome, skin.rest_mm, painter, seed, states, range_name, number)


def _tilted(rng: np.random.Generator, radius_mm: float, theta: float, distance_mm: float) -> Camera:
    draw = drawing(rng)
    disc_px = HEIGHT_PX * draw(0.37, 0.43)
    focal_px = disc_px * (distance_mm + radius_mm * math.cos(theta)) / (radius_mm * math.sin(theta))
    tilts = draw(1.5, 4.0) * rng.choice((-1, 1)), draw(1.5, 4.0) * rng.choice((-1, 1))
    # The middle of the skin stays near the middle of the image.
    off = [focal_px * math.tan(math.radians(tilt)) for tilt in tilts]
    row_c = (HEIGHT_PX - 1) / 2 + off[0] + draw(-8, 8)
    col_c = (WIDTH_PX - 1) / 2 - off[1] + draw(-20, 20)
    return Camera("pinhole", distance_mm, focal_px, row_c, col_c, 0.0, *tilts)


def _light(rng: np.random.Generator, radius_mm: float, distance_mm: float) -> Light:
    """Two or three LEDs on one side of the lens."""
    draw = drawing(rng)
    start, leds = draw(0, 2 * math.pi), []
    for k in range(int(rng.integers(2, 4))):
        angle = start + 0.9 * k
        far = radius_mm * draw(0.25, 0.4)
        leds.append((far * math.cos(angle), far * math.sin(angle), -distance_mm * draw(0.3, 0.8)))
    return Light(draw(170, 225), tuple(leds), gloss=draw(0.1, 0.3), sharpness=draw(150, 400))


def _print(rng: np.random.Generator, kind: str, skin: OblateSkin) -> tuple[Pins, Markers | None]:
    draw = drawing(rng)
    radius_mm = skin.radius_mm
    pitch_mm, far = draw(1.8, 2.4) * radius_mm / 20, lattices.reach(skin.half_angle_deg)
    pitch, turn = pitch_mm / radius_mm, draw(0, 1.0)
    places, between = lattices.rings(pitch, far, turn)
    if kind == "white spiral":
        places = lattices.spiral(pitch, far, turn)
    direction = lattices.on_sphere(places, far, draw(0.02, 0.05) * pitch, rng)
    count, bends = len(direction), draw(0.15, 0.4)
    if kind != "dark rings":
        tip_mm = draw(0.24, 0.3) * pitch_mm * rng.normal(1, 0.04, count)
        length_mm = np.full(count, draw(1.0, 1.6) * pitch_mm)
        return Pins(direction, 0.7 * tip_mm, tip_mm, length_mm, bends, 0.1, 0.95), None
    tip_mm = draw(0.3, 0.36) * pitch_mm * rng.normal(1, 0.04, count)
    length_mm = np.full(count, draw(1.2, 1.8) * pitch_mm)
    pins = Pins(direction, 0.8 * tip_mm, tip_mm, length_mm, bends, 0.07, 0.07, draw(1.0, 1.15))
    centre = lattices.on_sphere(between, far, 0.03 * pitch, rng)
    outer_mm = np.full(len(centre), draw(0.36, 0.42) * pitch_mm)
    return pins, Markers(centre, outer_mm, 0 * outer_mm)
