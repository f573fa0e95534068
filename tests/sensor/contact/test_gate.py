from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from support.calibrated_sensor import FULL, HALF, TACTIP, calibrated, pressed, unloaded
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.sensor.contact.gate import (
    GATE_PART,
    ContactGate,
    gate_preprocessor,
)
from tacshade_edge.sensor.image.preprocess import Preprocessor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import U8, Disc


def changed_part(image: U8, model: SensorModel = HALF, **of: Any) -> float:
    calibration = replace(calibrated(model, 0), **of)
    seen = gate_preprocessor(calibration, Preprocessor(calibration, PROFILES["accurate"]))
    return ContactGate(seen).changed_part(seen.preprocess(seen.grey(image)))


@pytest.mark.slow
@pytest.mark.parametrize("model", [HALF, FULL, TACTIP], ids=["half", "full", "tactip"])
def test_the_gate_closes_on_a_skin_at_rest_and_opens_on_a_faint_press(model: SensorModel) -> None:
    free = unloaded(model)
    assert changed_part(free, model) < 0.02
    for at_rest in (
        camera_faults.gain(free, 0.85),
        camera_faults.gain(free, 1.15),
        camera_faults.noise(free, 4, 1),
        camera_faults.uneven(free, model.row_c, model.col_c, model.disc_radius_px, 0.3, 30.0),
    ):
        assert changed_part(at_rest, model) < GATE_PART
    assert changed_part(pressed("ball", 0.3, model).image, model) > GATE_PART


@pytest.mark.parametrize("model", [HALF, TACTIP], ids=["half", "tactip"])
def test_the_white_shows_no_more_change_than_there_is(model: SensorModel) -> None:
    calibration = calibrated(model, 0)
    seen = gate_preprocessor(calibration, Preprocessor(calibration, PROFILES["accurate"]))
    gate, free = ContactGate(seen), unloaded(model)
    noise = np.random.default_rng(1).integers(0, 256, free.shape, dtype=np.uint8)
    touched = [pressed(name, mm, model).image for name in ("ball", "edge") for mm in (0.3, 2.0)]
    for image in (free, 255 - free, noise, noise * 0, camera_faults.gain(free, 1.4), *touched):
        white = seen.preprocess(seen.grey(image))
        least = gate.least_changed_part(seen.change_grey(seen.ratio(white.white)))
        assert least <= gate.changed_part(white)
    # It decides on a press without the exact part.
    assert least > gate.least_part


@pytest.mark.parametrize("name", ["ball", "plate"])
def test_it_asks_how_much_changed_and_not_in_which_direction(name: str) -> None:
    image = pressed(name, 1.0).image
    assert (
        changed_part(image, polarity="dark")
        == changed_part(image, polarity="bright")
        > 2 * GATE_PART
    )


def test_the_gate_of_a_disc_without_cells_is_closed() -> None:
    geometry = replace(calibrated(HALF, 0).geometry, disc=Disc(500.0, 500.0, 20.0))
    assert changed_part(unloaded(), geometry=geometry) == 0.0
