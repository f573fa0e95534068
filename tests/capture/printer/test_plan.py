from __future__ import annotations

import pytest

from tacshade_edge.capture.printer.plan import planned_presses
from tacshade_edge.core.calibration.indenters import box
from tacshade_edge.core.calibration.inputs import Sensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.settings.sensor_file import PrinterFile
from tacshade_edge.storage.tables.capture_folder import Stated

SENSOR = Sensor(20, 14, 50, "bright")
LIMITS = PrinterFile(x_mm=[0, 220], y_mm=[0, 220], z_mm=[40, 200], start_mm=[110, 110, 90], feed_mm_s=50)
NAMES = {"square": box("square", 6, 6)}
BALL = Stated(("ball", "6", "2.5", "1", "-3"))


def test_a_press_is_recognised_whatever_its_yaw_was() -> None:
    ball, square = planned_presses((BALL, Stated(("square", "", "2", "0", "5"))), NAMES, SENSOR, LIMITS)
    assert ball.taken_as(12.0) == BALL
    assert ball.is_taken_as(BALL)
    taken = square.taken_as(-12.345)
    assert taken.columns == ("square", "", "2", "0", "5", "-12.35", "", "", "", "")
    assert square.is_taken_as(taken)
    assert not ball.is_taken_as(taken)
    assert (ball.name, square.name) == ("ball of 6 mm", "square")


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (("ball", "6", "2.5", "", ""), "found no x_mm and y_mm"),
        (("square", "", "2", "0", "5", "30", "", "", "", ""), "found yaw, tilt or shear, expected none"),
        (
            ("ball", "6", "9", "0", "0"),
            "found 9.0 mm of travel from first touch, expected more than 0 mm and at most 6.7",
        ),
        (("ball", "6", "2", "15", "6"), "found a place 16.2 mm from the skin's axis, expected at most 15.3 mm, the"),
    ],
)
def test_what_a_printer_cannot_take_is_refused_before_it_moves(columns: tuple[str, ...], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        planned_presses((BALL, Stated(columns)), NAMES, SENSOR, LIMITS)
    assert said in str(caught.value)


def test_the_limits_hold_every_place_however_the_sensor_is_turned() -> None:
    near_the_edge = PrinterFile(x_mm=[0, 220], y_mm=[0, 118], z_mm=[40, 200], start_mm=[110, 110, 90], feed_mm_s=50)
    with pytest.raises(
        ConfigError,
        match=r"found a reach of 3.2 mm from the skin's axis, expected at most 3.0 mm, the limit set by y_mm",
    ):
        planned_presses((BALL,), NAMES, SENSOR, near_the_edge)


def test_a_ball_is_needed() -> None:
    with pytest.raises(ConfigError, match="found no ball press"):
        planned_presses((Stated(("square", "", "2", "0", "5")),), NAMES, SENSOR, LIMITS)
