from __future__ import annotations

import numpy as np
import pytest
from support.calibrated_sensor import loaded, references, sensor_of

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.reference.reference_load import quarter_turned
from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.core.geometry.disc import Grid
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator.model import random_model
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.types import Disc
from tools.testbed.simulator.other_family import OtherSensor, other_model


def test_a_turn_moves_what_stands_on_the_grid() -> None:
    grid, disc = Grid(5, 5, 10.0, 20.0, 4.0), Disc(18.0, 28.0, 8.0)
    values = np.zeros((5, 5), np.float32)
    values[0, 1] = 7  # two up and one left of the middle
    assert quarter_turned(values, grid, disc, 0)[0, 1] == 7
    found = [np.argwhere(quarter_turned(values, grid, disc, turns)).tolist() for turns in (1, 2, 3, 4)]
    assert sorted(found[:3]) == [[[1, 4]], [[3, 0]], [[4, 3]]]
    assert found[3] == [[0, 1]]


def test_light_at_the_rim_is_no_load() -> None:
    """LED rings make the skin next to them brighter: its profile rises by itself over the last two of twelve rings."""
    sensor = OtherSensor(other_model(33))
    calibrate(sensor_of(sensor.model), [sensor.frame((), 5).image])  # not refused
    pressed = sensor.frame((Press(OBJECTS["ball"](), 0.0, 0.0, 3.0, 0.0, skin_scale(sensor.model.geometry)),), 5).image
    with pytest.raises(ConfigError, match="seems pressed"):
        calibrate(sensor_of(sensor.model), [pressed])


@pytest.mark.slow
@pytest.mark.parametrize(("height", "seeds"), [(240, range(0, 12, 2)), (480, range(1))])
def test_a_load_is_told_from_none_on_other_sensors(height: int, seeds: range) -> None:
    """Of 32 loads 3 mm deep `python -m tools.studies.calibration --sensors 30 --detect 16 --first 8400` misses none."""
    missed = []
    for seed in seeds:
        model = random_model(seed, height, height * 4 // 3)
        calibrate(sensor_of(model), references(model, 3))  # never refused
        for x_mm in (0.0, 5.0):
            try:
                calibrate(sensor_of(model), loaded(3.0, x_mm, model))
            except ConfigError:
                continue
            missed.append((seed, x_mm))
    assert len(missed) <= 1


@pytest.mark.slow
def test_a_square_lattice_is_no_load() -> None:
    """Its rings are uneven at four places: for that these were refused. A load on one is not always told from them."""
    found = 0
    for seed in (40, 42, 44, 45, 48, 62):
        sensor = OtherSensor(other_model(seed))
        calibrate(sensor_of(sensor.model), [sensor.frame((), 5).image])
        scale = skin_scale(sensor.model.geometry)
        pressed = sensor.frame((Press(OBJECTS["ball"](), 4 * scale, 1 * scale, 3.0, 0.0, scale),), 5).image
        try:
            calibrate(sensor_of(sensor.model), [pressed])
        except ConfigError as error:
            found += "seems pressed" in str(error)
    assert found >= 4
