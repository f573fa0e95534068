import numpy as np
import pytest

from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.studies.evaluate.sensors import FAMILIES, SensorName, calibrated


@pytest.mark.parametrize("text", ["default", "5", "0", "8999"])
def test_a_name_is_written_as_it_is_read(text: str) -> None:
    assert str(SensorName.parse(text)) == text
    assert SensorName.parse(f"tacshade:{text}") == SensorName.parse(text)


@pytest.mark.parametrize("text", ["", "x", "-1", "1.5", "teapot:3", "tacshade:", ":5", "٣", "99999999999"])
def test_what_is_no_sensor_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected"):
        SensorName.parse(text)


def test_the_same_name_is_the_same_sensor() -> None:
    assert SensorName.parse("default").make().model == SensorModel()
    assert SensorName.parse("5").make().model == random_model(5)
    assert set(FAMILIES) >= {"tacshade"}


@pytest.mark.slow  # it renders and fits
def test_a_sensor_is_calibrated_on_what_its_images_show() -> None:
    made = calibrated(SensorName.parse("default"), references=3, presses=8)
    model, disc = SensorModel(), made.calibration.geometry.disc
    assert made.calibration.fit is not None
    assert made.calibration.fit.presses == 8
    assert np.hypot(disc.row_c - model.row_c, disc.col_c - model.col_c) < 3
    assert (disc.row_c, disc.col_c) != (model.row_c, model.col_c)


@pytest.mark.slow  # likewise
def test_a_sensor_that_cannot_be_calibrated_is_named() -> None:
    with pytest.raises(ConfigError, match=r"sensor 5: found 2 presses, expected at least 8"):
        calibrated(SensorName.parse("5"), references=1, presses=2)
