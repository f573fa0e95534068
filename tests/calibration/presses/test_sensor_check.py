from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import pytest

from support.calibrated_sensor import HALF, presses, references, sensor_of
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.observation import PressObservation
from tacshade_edge.calibration.presses.press_check import PressCheck
from tacshade_edge.calibration.presses.sensor_check import wrong_keys
from tacshade_edge.calibration.sentences import sentence
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.simulator.sensor_model import SensorModel, flattened
from tacshade_edge.sensor.inference.network import load_networks
from tacshade_edge.types import Geometry


def said(seen: Sequence[PressObservation], geometry: Geometry) -> str:
    keys = wrong_keys(seen, geometry)
    return sentence(keys) if keys else ""


def found(key: str = "", factor: float = 1.0, table: Sequence[KnownPress] = ()) -> str:
    """What the presses say of SENSOR.yaml in which this key is off by a factor."""
    stated = sensor_of(HALF)
    wrong = replace(stated, **{key: factor * getattr(stated, key)}) if key else stated
    unloaded = calibrate(wrong, references()).calibration
    check = PressCheck(unloaded, load_networks()["accurate"])
    return said(
        [check.observation(check.look(one.image), one) for one in table or presses()],
        unloaded.geometry,
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


FORMS = {"dome": HALF, "pad": flattened(HALF)}


def said_of(pressed: SensorModel, stated: SensorModel) -> str:
    """What the presses of one sensor say of the SENSOR.yaml of another with the same picture."""
    unloaded = calibrate(sensor_of(stated), references(pressed)).calibration
    check = PressCheck(unloaded, load_networks()["accurate"])
    seen = [check.observation(check.look(one.image), one) for one in presses(pressed)]
    return said(seen, unloaded.geometry)


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_a_skin_of_the_stated_form_is_not_doubted(form: str) -> None:
    assert said_of(FORMS[form], FORMS[form]) == ""


@pytest.mark.slow
def test_a_pad_that_is_called_a_dome_is_named_with_its_size_and_lens() -> None:
    heard = said_of(FORMS["pad"], FORMS["dome"])
    found = "skin: found a dome (skin_radius_mm 20, visible_half_angle_deg 50, camera_distance_mm"
    assert heard.startswith(f"SENSOR.yaml: {found}")
    assert "expected a pad (visible_radius_mm 15, camera_distance_mm " in heard


@pytest.mark.slow
def test_a_dome_that_is_called_a_pad_is_named_with_its_radius_and_lens() -> None:
    heard = said_of(FORMS["dome"], FORMS["pad"])
    found = r"skin: found a pad \(visible_radius_mm 15, camera_distance_mm 27\)"
    dome = (
        r"a dome \(skin_radius_mm (\d+), visible_half_angle_deg (\d+), camera_distance_mm -?\d+\)"
    )
    named = re.search(f"{found}, expected {dome} by the presses", heard)
    assert named is not None
    assert int(named[1]) == pytest.approx(20, abs=3)
    assert int(named[2]) == pytest.approx(50, abs=10)


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
