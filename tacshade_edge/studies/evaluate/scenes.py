"""The images of Experiment 1 with their ground truth: presses, and frames without contact."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.studies.evaluate.score import NOTHING, KnownTruth, Label
from tacshade_edge.studies.evaluate.sensors import NULL_NOISE, SCENE_NOISE, PressedSensor, SensorName
from tacshade_edge.types import U8

DEPTHS_MM = (1.5, 3.0, 4.5)
RINGS = ((0.0, 0.1), (0.2, 0.28), (0.32, 0.38))
"""Ranges of the distance from the tip, in skin radii: in the middle, next to it, and well off it."""
NULL_FRAMES = 20


@dataclass(frozen=True, slots=True)
class Scene:
    """One press and the seed of its image's noise."""

    object_name: str
    press: Press
    noise_seed: int


def places(model: SensorModel, seed: int | None) -> list[tuple[float, float, float]]:
    """Draw x and y in mm and a rotation in degrees, one in each of `RINGS`; the same seed gives the same places."""
    rng = np.random.default_rng((0 if seed is None else seed + 1, 21))
    drawn = []
    for low, high in RINGS:
        rho, angle = model.skin_radius_mm * rng.uniform(low, high), rng.uniform(0, 2 * math.pi)
        turn = rng.uniform(0, 360)
        drawn.append((round(rho * math.cos(angle), 3), round(rho * math.sin(angle), 3), round(turn, 1)))
    return drawn


def scenes(
    model: SensorModel, seed: int | None, object_name: str, depths_mm: Sequence[float] = DEPTHS_MM
) -> list[Scene]:
    """Scenes of one object at every place and depth; the object scales with the skin radius relative to 20 mm."""
    scale = model.skin_radius_mm / 20
    shape = OBJECTS[object_name]()
    grid = [(place, depth) for place in places(model, seed) for depth in depths_mm]
    return [
        Scene(object_name, Press(shape, x, y, depth, turn, scale), SCENE_NOISE + k)
        for k, ((x, y, turn), depth) in enumerate(grid)
    ]


def null_images(sensor: PressedSensor, count: int = NULL_FRAMES) -> list[tuple[str, U8]]:
    """Frames without contact, as from a sensor in use, each with the name of the change made to it.

    In turn, they are unchanged, in other light, and shifted by a pixel.
    """
    nuisances: list[tuple[str, Callable[[U8], U8]]] = [
        ("", lambda image: image),
        ("light x0.8", lambda image: nuisance.gain(image, 0.8)),
        ("light x1.2", lambda image: nuisance.gain(image, 1.2)),
        ("a row down", lambda image: nuisance.shift(image, 1, 0)),
        ("a column right", lambda image: nuisance.shift(image, 0, 1)),
    ]
    made = []
    for k in range(count):
        what, change = nuisances[k % len(nuisances)]
        made.append((what, change(sensor.frame((), NULL_NOISE + k).image)))
    return made


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """An image (uint8, H x W or H x W x 3) with its label and ground truth."""

    label: Label
    truth: KnownTruth
    image: U8

    @property
    def touched(self) -> bool:
        """Whether anything truly touches."""
        return len(self.truth.points_mm) > 0


def press_cases(name: SensorName, sensor: PressedSensor, scenes: Iterable[Scene]) -> Iterator[Case]:
    """Yield a picture of each scene with its ground truth."""
    for scene in scenes:
        press, frame = scene.press, sensor.frame((scene.press,), scene.noise_seed)
        label = Label(str(name), scene.object_name, "", press.depth_mm, press.x_mm, press.y_mm, press.rotation_deg)
        yield Case(label, KnownTruth.of(frame.truth()), frame.image)


def null_cases(name: SensorName, sensor: PressedSensor, count: int) -> Iterator[Case]:
    """Yield pictures of the untouched skin (`null_images`)."""
    nothing = KnownTruth(NOTHING, 0.0, None)
    for what, image in null_images(sensor, count):
        yield Case(Label(str(name), "none", what), nothing, image)
