"""Ball presses on simulated sensors as calibration observes them, made once per test session."""

from __future__ import annotations

from functools import cache

from support.calibrated_sensor import random_sensor, references, sensor_of, simulated
from support.shared import once_for_all_workers
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.observation import PressObservation, observe_press
from tacshade_edge.calibration.reference.references import PROFILE
from tacshade_edge.lab.simulator.script import ball_presses
from tacshade_edge.sensor.image.preprocess import GreyMapper, Preprocessor
from tacshade_edge.types import Geometry

PRESSES = 24
SEEDS = (0, 5, 11)
"""Sensors of different pattern, radius and camera."""


@cache
def observed(seed: int) -> tuple[tuple[PressObservation, ...], Geometry]:
    """24 ball presses on the sensor of a seed, stated as they are, and its geometry."""
    return once_for_all_workers(f"observed {seed}", lambda: _observe(seed))


def _observe(seed: int) -> tuple[tuple[PressObservation, ...], Geometry]:
    model = random_sensor(seed)
    unloaded = calibrate(sensor_of(model), references(model)).calibration
    preprocessor = Preprocessor(unloaded, PROFILE)
    mapper = GreyMapper(preprocessor)
    presses = [
        KnownPress(
            f"press {k}",
            simulated(model).frame((p,), 100 + k).image,
            radius,
            p.depth_mm,
            p.x_mm,
            p.y_mm,
        )
        for k, (p, radius) in enumerate(ball_presses(model, PRESSES, seed))
    ]
    maps = [mapper.maps(preprocessor.preprocess(preprocessor.grey(each.image))) for each in presses]
    observed = zip(maps, presses, strict=True)
    return tuple(observe_press(preprocessor, *each) for each in observed), unloaded.geometry
