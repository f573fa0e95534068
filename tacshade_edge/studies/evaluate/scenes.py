"""The presses of Experiment 1, and frames without contact."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.studies.evaluate.sensors import NULL_NOISE, SCENE_NOISE, PressedSensor
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
    """Frames without contact, as from a sensor in use: in turn unchanged, in other light, shifted by a pixel.

    Returns
    -------
    list of (name of the change, image)
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
