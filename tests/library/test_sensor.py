"""load and reconstruct: what the command `reconstruct` writes, in memory."""

from __future__ import annotations

import base64
import json
import math
import pickle
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import FrozenInstanceError
from pathlib import Path

import cv2
import numpy as np
import pytest

import tacshade_edge as ts
from support.calibrated_sensor import HALF, calibrated, pressed, unloaded
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import main
from tacshade_edge.sensor.contact.tracking import ContactTracker
from tacshade_edge.types import Frame, TouchedObject


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sensor") / "cal.npz"
    calibration_file.save(path, calibrated())
    return path


@pytest.fixture(scope="module")
def sensor(calibration: Path) -> ts.Sensor:
    return ts.load(calibration)


def test_it_is_what_the_command_writes(
    sensor: ts.Sensor, calibration: Path, tmp_path: Path
) -> None:
    image = tmp_path / "press.png"
    cv2.imwrite(str(image), pressed("cube", 2.0).image)
    result = sensor.reconstruct(image)
    assert (
        main(["reconstruct", "--calibration", str(calibration), "--out", str(tmp_path), str(image)])
        == 0
    )
    with np.load(tmp_path / "press.npz") as written:
        for key in written.files:
            np.testing.assert_array_equal(getattr(result, key), written[key], err_msg=key)
    assert (result.valid, result.reason, result.reason_code, result.in_contact) == (
        True,
        "",
        "",
        True,
    )
    assert result.depth_max_mm == result.objects[0].depth_max_mm == pytest.approx(2.0, rel=0.2)
    (record,) = json.loads((tmp_path / "summary.json").read_text())
    assert result.touch is not None
    assert result.touch_sigma is not None
    assert record["touch"] == pytest.approx(result.touch, abs=1e-4)
    assert record["touch_sigma"] == pytest.approx(result.touch_sigma, abs=1e-4)
    assert [record[key] for key in ("touch_reason", "touch_reason_code")] == ["", ""]
    assert (result.touch_reason, result.touch_reason_code) == ("", "")
    assert result.profile == sensor.profile == "balanced"


def test_a_file_and_its_pixels_give_the_same(sensor: ts.Sensor, tmp_path: Path) -> None:
    image = np.array(pressed("ball", 2.0).image)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    of_file, of_pixels = sensor.reconstruct(str(tmp_path / "a.png")), sensor.reconstruct(image)
    colour = np.asfortranarray(
        image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    )
    for other in (of_pixels, sensor.reconstruct(colour)):
        np.testing.assert_array_equal(of_file.height_mm, other.height_mm)


def test_the_skin_lies_where_the_points_are(sensor: ts.Sensor) -> None:
    result = sensor.reconstruct(np.array(pressed("ball", 2.0).image))
    skin_mm = result.skin_mm()
    assert skin_mm.shape == (*result.height_mm.shape, 3)
    touched = {tuple(point) for point in skin_mm[result.contact].tolist()}
    assert touched == {tuple(point) for point in result.points_mm.tolist()}


def test_results_are_frozen_and_no_thread_is_left(sensor: ts.Sensor) -> None:
    before = set(threading.enumerate())
    result = sensor.reconstruct(np.array(unloaded()))
    with pytest.raises(FrozenInstanceError):
        result.valid = False  # type: ignore[misc]
    for name in (
        "height_mm",
        "contact",
        "untrusted",
        "shear_mm",
        "sigma_mm",
        "points_mm",
        "labels",
    ):
        assert not getattr(result, name).flags.writeable, name
    assert not result.in_contact
    assert (result.touch, result.touch_sigma) == (None, None)
    assert np.nanmax(np.abs(result.height_mm)) == 0
    assert set(threading.enumerate()) <= before


def test_what_cannot_be_used_says_so(sensor: ts.Sensor, tmp_path: Path) -> None:
    black = sensor.reconstruct(np.zeros((HALF.image_height_px, HALF.image_width_px), np.uint8))
    small = sensor.reconstruct(np.zeros((10, 10), np.uint8))
    assert [(r.valid, r.reason_code, bool(r.reason)) for r in (black, small)] == [
        (False, "black", True),
        (False, "size", True),
    ]
    with pytest.raises(ts.ConfigError, match=r"float64 \(3, 3\), expected a path, or uint8"):
        sensor.reconstruct(np.zeros((3, 3)))  # type: ignore[arg-type]
    with pytest.raises(ts.DecodeError, match=r"nothing\.png: No such file"):
        sensor.reconstruct(tmp_path / "nothing.png")
    with pytest.raises(
        ts.ConfigError,
        match="profile: found 'auto', expected one of accurate, balanced, fast, paper",
    ):
        ts.Sensor(calibrated(), "auto")


def test_a_sensor_that_another_thread_is_using_refuses(sensor: ts.Sensor) -> None:
    class Meanwhile(ContactTracker):
        """Lets another thread use the sensor while a frame's objects are followed."""

        def step(self, t_ns: int, objects: Sequence[TouchedObject]) -> tuple[TouchedObject, ...]:
            with ThreadPoolExecutor(1) as other:
                refused.append(other.submit(sensor.reconstruct, unloaded()).exception())
            return super().step(t_ns, objects)

    refused: list[BaseException | None] = []
    made = sensor.step(Frame(0, 0, 0, pressed("ball", 2.0).image), Meanwhile())
    assert made.valid
    (error,) = refused
    assert isinstance(error, ts.ConfigError)
    assert "found two threads using one sensor, expected one thread" in str(error)
    assert sensor.reconstruct(unloaded()).valid


def test_a_notebook_shows_a_line_and_a_picture(sensor: ts.Sensor) -> None:
    result, black = (
        sensor.reconstruct(image) for image in (pressed("ball", 2.0).image, 0 * unloaded())
    )
    assert repr(sensor).startswith("<Sensor of radius 20 mm, balanced, images of ")
    assert repr(result) == f"<Result 0 of balanced: 1 object, deepest {result.depth_max_mm:.2f} mm>"
    shown = result._repr_html_()
    data = shown.split("base64,")[1].split('"')[0]
    assert (
        cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR).shape[0]
        > 112
    )
    assert not black.valid
    assert math.isnan(black.depth_max_mm)
    assert black.reason in repr(black)


def test_the_outline_is_the_papers_if_it_is_asked_for(calibration: Path) -> None:
    image = np.array(pressed("ball", 3.0).image)
    by_network, by_heights = (
        ts.load(calibration, outline=outline).reconstruct(image)
        for outline in ("network", "kmeans")
    )
    np.testing.assert_array_equal(by_network.height_mm, by_heights.height_mm)
    assert (by_network.contact != by_heights.contact).any()
    with pytest.raises(
        ts.ConfigError, match="outline: found 'otsu', expected one of network, kmeans"
    ):
        ts.load(calibration, outline="otsu")  # type: ignore[arg-type]


def test_a_sensor_goes_to_other_processes(sensor: ts.Sensor) -> None:
    image = pressed("cube", 2.0).image
    sent = pickle.loads(pickle.dumps(sensor))
    assert repr(sent) == repr(sensor)
    np.testing.assert_array_equal(
        sent.reconstruct(image).height_mm, sensor.reconstruct(image).height_mm
    )
    result = sensor.reconstruct(image)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(result)).height_mm, result.height_mm)
