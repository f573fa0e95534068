"""Variants of a sensor of any family: with a noiseless camera, and after a release."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace

from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.render import Renderer
from tacshade_edge.simulator.scene import SimulatedFrame, SimulatedSensor, skin_under
from tacshade_edge.simulator.skin import left_over
from tacshade_edge.studies.evaluate.sensors import PressedSensor
from tools.testbed.simulator.other_family import OtherSensor


def noiseless(sensor: PressedSensor) -> PressedSensor:
    """Make the same sensor with a noiseless camera."""
    if isinstance(sensor, OtherSensor):
        return sensor.noiseless()
    return SimulatedSensor(replace(sensor.model, read_noise_grey=0.0, shot_noise_grey=0.0))


def released(sensor: PressedSensor, presses: Sequence[Press], part: float, noise_seed: int = 0) -> SimulatedFrame:
    """Take a picture after a release, while the skin still keeps part of its deformation."""
    if isinstance(sensor, OtherSensor):
        return sensor.released(presses, part, noise_seed)
    skin, renderer = left_over(skin_under(sensor.model, tuple(presses)), part), _renderer(sensor.model)
    return SimulatedFrame(renderer.expose(renderer.draw(skin), noise_seed), (), skin, sensor.model)


@functools.lru_cache(maxsize=2)
def _renderer(model: SensorModel) -> Renderer:
    return Renderer(model)
