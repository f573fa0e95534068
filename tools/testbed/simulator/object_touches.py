"""Touches of solids as a hand makes them: anywhere near the tip, light or firm, turned, half of
them dragged.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.lab.simulator.press import Press, Shape
from tacshade_edge.lab.studies.evaluate.work import PressedSensor, reconstructor
from tacshade_edge.sensor.geometry.disc import DiscRays
from tacshade_edge.sensor.recognition.naming import describe_touch
from tacshade_edge.types import F32, Bool, Calibration, Frame, Geometry, HeightMap

REACH = 0.38  # of the places, in skin radii from the tip
DEPTHS_MM = 1.5, 4.5
DRAG_MM = 1.5
TILT_DEG, TILTED_PART = (
    3.0,
    0.2,
)  # deviation of a tilt about x and y, and the part of the touches that have one
_NOISE = 5000  # first seed of their pictures' noise


def draw_touch(
    rng: np.random.Generator, shape: Shape, skin_radius_mm: float, *, tilts: bool = False
) -> Press:
    """Draw a touch of a solid in life size."""
    rho, way = skin_radius_mm * REACH * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
    drag = rng.uniform(0, DRAG_MM) if rng.random() < 0.5 else 0.0
    along = rng.uniform(0, 2 * math.pi)
    tilted = tilts and rng.random() < TILTED_PART
    tilt_x, tilt_y = rng.normal(0, TILT_DEG, 2).tolist() if tilted else (0.0, 0.0)
    return Press(
        shape,
        x_mm=rho * math.cos(way),
        y_mm=rho * math.sin(way),
        depth_mm=rng.uniform(*DEPTHS_MM),
        rotation_deg=rng.uniform(0, 360),
        tilt_x_deg=tilt_x,
        tilt_y_deg=tilt_y,
        drag_x_mm=drag * math.cos(along),
        drag_y_mm=drag * math.sin(along),
    )


@dataclass(frozen=True, slots=True, eq=False)
class SeenTouches:
    """One profile's maps of a sensor's touches: heights (n, rows, cols), contact, and what places
    their cells.
    """

    heights_mm: Sequence[F32] | F32
    contact: Sequence[Bool] | Bool
    row0: float
    col0: float
    step_px: float
    rays: DiscRays
    geometry: Geometry

    def descriptions(self) -> list[F32 | None]:
        """The description of each touch; None where it is too light."""
        place = self.row0, self.col0, self.step_px
        maps = (HeightMap(h, c, *place) for h, c in zip(self.heights_mm, self.contact, strict=True))
        return [describe_touch(each, self.rays, self.geometry) for each in maps]


def see_touches(
    sensor: PressedSensor,
    calibration: Calibration,
    presses: Iterable[Press],
    profiles: Sequence[str],
) -> dict[str, SeenTouches]:
    """Take a picture of each touch, and reconstruct it with every profile."""
    made = {name: reconstructor(calibration, name) for name in profiles}
    maps: dict[str, list[HeightMap]] = {name: [] for name in profiles}
    for k, press in enumerate(presses):
        image = sensor.frame((press,), _NOISE + k).image
        for name, each in made.items():
            maps[name].append(each.step(Frame(k, 0, 0, image)).height)
    return {
        name: SeenTouches(
            [each.height_mm for each in maps[name]],
            [each.contact for each in maps[name]],
            made[name].grid.row0,
            made[name].grid.col0,
            made[name].grid.step_px,
            made[name].rays,
            calibration.geometry,
        )
        for name in profiles
    }
