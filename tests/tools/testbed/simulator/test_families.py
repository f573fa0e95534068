"""Families beside the product's own."""

from __future__ import annotations

import argparse
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import pytest

from tacshade_edge.studies.evaluate.sensors import FAMILIES, SensorName
from tools.testbed.simulator.families import FINAL_SENSORS, sensor_name, working_sensors
from tools.testbed.simulator.other_family import OtherSensor


@pytest.mark.parametrize("family", ["other", "square", "capped", "two-scales"])
def test_a_family_is_known_by_its_name(family: str) -> None:
    name = sensor_name(f"{family}:31")
    assert (str(name), name.family in FAMILIES) == (f"{family}:31", True)
    assert isinstance(name.make(), OtherSensor)


def test_another_process_knows_the_family_of_a_name_that_it_is_given() -> None:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        assert (
            pool.submit(SensorName.make, sensor_name("other:31")).result().model == sensor_name("other:31").make().model
        )


def test_final_sensors_are_those_that_nobody_may_name() -> None:
    assert len(FINAL_SENSORS) >= 3
    assert all(name.seed is not None and name.seed >= 9000 for name in FINAL_SENSORS)
    for name in FINAL_SENSORS:
        with pytest.raises(argparse.ArgumentTypeError, match="kept for --final"):
            working_sensors(str(name))
