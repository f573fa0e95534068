from __future__ import annotations

import math
from pathlib import Path

import pytest

from tacshade_edge.calibration.files.sensor_file import check_value, read_sensor
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import Disc

LEAST = "skin_radius_mm: 20\nvisible_half_angle_deg: 50\npolarity: bright\n"


def sensor_file(folder: Path, text: str) -> Path:
    path = folder / "SENSOR.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_least_that_must_be_said_and_its_defaults(tmp_path: Path) -> None:
    sensor = read_sensor(sensor_file(tmp_path, LEAST))
    assert sensor == StatedSensor(
        20.0, None, 50.0, "bright", 15.0, None, (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), None
    )


def test_everything_that_can_be_said(tmp_path: Path) -> None:
    text = LEAST.replace("bright", "dark") + (
        "camera_distance_mm: 14\n"
        "alpha: 3\n"
        "binarisation: otsu\n"
        "flange_T_sensor: [1, -2, 30.5, 0, 0.6, 0.8, 0]\n"
        "visible_circle: {row_px: 240.5, col_px: 310, radius_px: 205}\n"
        "print: {pin_length_mm: 3.1, pitch_mm: 2}\n"
    )
    sensor = read_sensor(sensor_file(tmp_path, text))
    assert sensor == StatedSensor(
        20.0,
        14.0,
        50.0,
        "dark",
        3.0,
        "otsu",
        (1.0, -2.0, 30.5, 0.0, 0.6, 0.8, 0.0),
        Disc(240.5, 310.0, 205.0),
        {"pitch_mm": 2.0, "pin_length_mm": 3.1},
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "found nothing, expected a mapping"),
        (LEAST + "colour: red\n", r":4: colour: "),
        (LEAST.replace("20", "-1"), r":1: skin_radius_mm: found -1"),
        (LEAST.replace("20", "0.02"), r":1: skin_radius_mm: found 0.02"),  # metres
        (LEAST.replace("20", ".nan"), r":1: skin_radius_mm: found \.nan"),
        (LEAST.replace("bright", "up"), r":3: polarity: found up"),
        (LEAST + "flange_T_sensor: [0, 0, x, 1, 0, 0, 0]\n", r":4: flange_T_sensor\.2: found x"),
        (
            LEAST + "flange_T_sensor: [0, {}, 0, 1, 0, 0, 0]\n",
            r":4: flange_T_sensor\.1: found a mapping",
        ),
        (
            LEAST + "flange_T_sensor: [0, 1.0e+300, 0, 1, 0, 0, 0]\n",
            r":4: flange_T_sensor: found a place 1e\+300 mm away",
        ),
        (LEAST.replace("20", "9" * 400), r":1: skin_radius_mm: found '9{60}…'"),
        (
            LEAST + "flange_T_sensor: [0, 0, 0, 1, 1, 0, 0]\n",
            r":4: flange_T_sensor: found a quaternion of length 1\.41",
        ),
        (
            LEAST + "visible_circle: {row_px: 1, col_px: 2}\n",
            r": visible_circle\.radius_px: found nothing",
        ),
        (
            LEAST + "visible_circle: {row_px: 1, col_px: 2, radius_px: 2}\n",
            r":4: visible_circle\.radius_px: found 2",
        ),
        (LEAST + "visible_circle: 205\n", r":4: visible_circle: found 205"),
        (LEAST + "print: {pin_length_mm: 0}\n", r":4: print\.pin_length_mm: found 0"),
    ],
)
def test_a_wrong_sensor_is_named_by_line_and_key(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as refusal:
        read_sensor(sensor_file(tmp_path, text))
    assert "\n" not in str(refusal.value)


def test_a_typed_value_is_checked_like_the_file(tmp_path: Path) -> None:
    assert [check_value("skin_radius_mm", "20"), check_value("polarity", "dark")] == [20, "dark"]
    for key, text in (
        ("skin_radius_mm", "0.02"),
        ("skin_radius_mm", ""),
        ("polarity", "1"),
        ("skin_radius_mm", "nan"),
    ):
        with pytest.raises(ConfigError, match=f"^{key}: found {text or 'nothing'}"):
            check_value(key, text)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            "[1, 2, 3]",
            "found a list of 3, expected a list of 7 numbers (x_mm, y_mm, z_mm, qw, qx, qy, qz)",
        ),
        ("1", "found 1, expected a list of 7 numbers (x_mm, y_mm, z_mm, qw, qx, qy, qz)"),
    ],
)
def test_where_the_sensor_is_on_the_flange_is_seven_numbers(
    tmp_path: Path, given: str, said: str
) -> None:
    path = tmp_path / "SENSOR.yaml"
    path.write_text(
        f"flange_T_sensor: {given}\n"
        "skin_radius_mm: 20\n"
        "visible_half_angle_deg: 50\n"
        "polarity: bright\n"
    )
    with pytest.raises(ConfigError) as caught:
        read_sensor(path)
    assert str(caught.value) == f"{path}:1: flange_T_sensor: {said}"


PAD = "skin: pad\nvisible_radius_mm: 15\npolarity: dark\n"


def test_a_pad_and_its_lens(tmp_path: Path) -> None:
    sensor = read_sensor(sensor_file(tmp_path, PAD + "camera_distance_mm: 27\n"))
    assert sensor == StatedSensor(math.inf, 27.0, 0.0, "dark", pad_radius_mm=15.0)
    assert read_sensor(sensor_file(tmp_path, PAD)).camera_distance_mm is None


def test_a_dome_states_its_half_angle_or_the_radius_of_its_visible_circle(tmp_path: Path) -> None:
    for r_mm, half_angle_deg in ((20.0, 50.0), (1e4, math.degrees(math.asin(15 / 1e4)))):
        circle_mm = r_mm * math.sin(math.radians(half_angle_deg))
        text = f"skin: dome\nskin_radius_mm: {r_mm}\nvisible_radius_mm: {circle_mm!r}\n"
        lens = f"camera_distance_mm: {27 - r_mm}\n"
        sensor = read_sensor(sensor_file(tmp_path, text + lens))
        assert (sensor.skin_radius_mm, sensor.camera_distance_mm) == (r_mm, 27 - r_mm)
        assert sensor.visible_half_angle_deg == pytest.approx(half_angle_deg)
        assert sensor.pad_radius_mm is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (PAD + "skin_radius_mm: 20\n", r":4: skin_radius_mm: found an unknown key"),
        (PAD + "visible_half_angle_deg: 50\n", r":4: visible_half_angle_deg: found an unknown"),
        (PAD + "camera_distance_mm: -3\n", r":4: camera_distance_mm: found -3"),
        ("skin: pad\n", r": visible_radius_mm: found nothing"),
        ("skin: flat\n" + LEAST, r":1: skin: found flat, expected one of dome, pad"),
        (
            "skin_radius_mm: 20\n",
            r": visible_half_angle_deg: found neither it nor visible_radius_mm",
        ),
        (LEAST + "visible_radius_mm: 9\n", r":2: visible_half_angle_deg: found it and also"),
        (
            "skin_radius_mm: 20\nvisible_radius_mm: 20\n",
            r":2: visible_radius_mm: found 20, expected at most 19\.9239",
        ),
        (
            LEAST + "camera_distance_mm: -13\n",
            (
                r":4: camera_distance_mm: found -13, expected a lens behind the visible circle, "
                r"above -12\.9"
            ),
        ),
    ],
)
def test_a_form_that_no_skin_has_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        read_sensor(sensor_file(tmp_path, text))


def test_a_typed_value_of_a_pad_is_checked(tmp_path: Path) -> None:
    assert check_value("visible_radius_mm", "15", "pad") == 15
    with pytest.raises(
        ConfigError, match=r"^camera_distance_mm: found -1, .*lens behind the skin's plane"
    ):
        check_value("camera_distance_mm", "-1", "pad")
