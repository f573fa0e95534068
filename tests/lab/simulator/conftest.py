from dataclasses import replace

import pytest

from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.truth import SimulatedSensor


@pytest.fixture(scope="session")
def sensor() -> SimulatedSensor:
    return SimulatedSensor(SensorModel())


@pytest.fixture(scope="session")
def small_sensor() -> SimulatedSensor:
    return SimulatedSensor(
        replace(
            SensorModel(),
            image_height_px=120,
            image_width_px=160,
            row_c=58.7,
            col_c=82.3,
            disc_radius_px=51.0,
        )
    )
