from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
from support.calibrated_sensor import HALF, presses, references, sensor_of

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.presses.press_check import PressCheck
from tacshade_edge.core.calibration.presses.sensor_check import wrong_keys
from tacshade_edge.errors import ConfigError
from tacshade_edge.inference.network import load_networks


def found(key: str = "", factor: float = 1.0, table: Sequence[KnownPress] = ()) -> str:
    """What the presses say of SENSOR.yaml in which this key is off by a factor."""
    stated = sensor_of(HALF)
    wrong = replace(stated, **{key: factor * getattr(stated, key)}) if key else stated
    unloaded = calibrate(wrong, references()).calibration
    check = PressCheck(unloaded, load_networks()["accurate"])
    return wrong_keys(
        [check.see(check.observe(one), one) for one in table or presses()], unloaded.geometry
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "factor"),
    [
        ("camera_distance_mm", 0.5),
        ("visible_half_angle_deg", 0.8),
        ("visible_half_angle_deg", 1.2),
        ("skin_radius_mm", 0.8),
        ("skin_radius_mm", 1.25),
    ],
)
def test_a_wrong_key_is_among_those_that_the_presses_name(key: str, factor: float) -> None:
    assert f"{key}: found " in found(key, factor)


@pytest.mark.slow
def test_a_few_mistaken_presses_hide_no_wrong_key() -> None:
    mistaken = [
        replace(one, depth_mm=one.depth_mm * (2 if k % 10 == 0 else 1))
        for k, one in enumerate(presses())
    ]
    assert "camera_distance_mm: found " in found("camera_distance_mm", 0.5, mistaken)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nothing", "radii", "places", "depths"])
def test_other_mistakes_name_no_key(kind: str) -> None:
    wrong = {
        "nothing": presses(),
        "radii": [replace(one, radius_mm=2 * one.radius_mm) for one in presses()],
        "places": [replace(one, x_mm=(one.x_mm or 0) + 1) for one in presses()],
        "depths": [replace(one, depth_mm=1.2 * one.depth_mm) for one in presses()],
    }
    assert found(table=wrong[kind]) == ""


@pytest.mark.slow
def test_balls_that_look_small_because_of_the_sensors_file_are_no_diameters() -> None:
    wrong = replace(sensor_of(HALF), skin_radius_mm=0.7 * HALF.skin_radius_mm)
    with pytest.raises(ConfigError, match=r"^SENSOR\.yaml: .*skin_radius_mm: found 14"):
        calibrate(wrong, references(), presses(), networks=load_networks())
