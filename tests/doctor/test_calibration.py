from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.calibrated_sensor import HALF, calibrated, pressed, unloaded
from support.fitted import fitted_with

from tacshade_edge.doctor.calibration import check_images, load
from tacshade_edge.doctor.finding import Finding
from tacshade_edge.settings import load as load_settings
from tacshade_edge.simulator import nuisance
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.types import U8
from tools.testbed.painted_sensor import painted_calibration


def judged(images: Sequence[U8], live: bool = True) -> dict[str, Finding]:
    findings = check_images(calibrated(HALF), images, live)
    assert all(bool(finding.fix) == (finding.state != "ok") for finding in findings)
    return {finding.check: finding for finding in findings}


def free(count: int = 5) -> list[U8]:
    return [unloaded(noise_seed=50 + k) for k in range(count)]


@pytest.mark.slow
def test_a_sensor_as_it_was_calibrated() -> None:
    findings = judged(free())
    assert [finding.state for finding in findings.values()] == ["ok", "ok"]
    assert findings["sensor"].found.startswith("the image matches the calibration and shows no contact, noise of ")


@pytest.mark.slow
def test_a_camera_that_moved() -> None:
    shifted = [np.roll(image, 4, axis=1) for image in free()]
    sensor = judged(shifted)["sensor"]
    assert sensor.state == "fault"
    assert sensor.found.startswith(
        ("frames are unusable: the camera has moved by 3.", "frames are unusable: the camera has moved by 4.")
    )
    assert "fasten the camera where it was" in sensor.fix


def test_a_camera_that_came_closer() -> None:
    rows, cols = unloaded().shape[:2]
    zoom = cv2.getRotationMatrix2D((cols / 2, rows / 2), 0, 1.03)
    place = judged([np.asarray(cv2.warpAffine(image, zoom, (cols, rows)), np.uint8) for image in free()])[
        "camera place"
    ]
    assert place.state == "warning"
    assert place.found.startswith("the visible circle ")
    assert "move it back" in place.fix


def test_a_sensor_that_aged() -> None:
    sensor = judged([nuisance.gain(image, 0.7) for image in free()])["sensor"]
    assert sensor.state == "warning"
    assert sensor.found.endswith("times the light since the calibration")
    assert "--rezero" in sensor.fix


def test_a_pressed_skin() -> None:
    images = [pressed("ball", 3.0).image]
    sensor = judged(images)["sensor"]
    assert sensor.state == "warning"
    assert "the skin seems to be pressed" in sensor.found
    assert judged(images, live=False)["sensor"].state == "ok", "files show presses"


@pytest.mark.parametrize(
    ("image", "reason", "fix"),
    [
        (np.zeros((240, 320), np.uint8), "black", "switch the sensor's light on"),
        (
            np.zeros((480, 640), np.uint8),
            "size: found 640x480 px, expected the calibration's 320x240 px",
            "set source.width_px",
        ),
        (np.full((240, 320), 255, np.uint8), "saturated", "dim the sensor's light"),
        ((unloaded() * 0.35).astype(np.uint8), "light: ", "restore the light"),
    ],
)
def test_an_image_that_cannot_be_used(image: U8, reason: str, fix: str) -> None:
    sensor = judged([image])["sensor"]
    assert sensor.state == "fault"
    assert sensor.found.startswith(f"frames are unusable: {reason}")
    assert sensor.fix.startswith(fix)


def test_a_sensor_that_shakes() -> None:
    shaken = [np.roll(image, k % 2, axis=1) for k, image in enumerate(free(6))]
    sensor = judged(shaken)["sensor"]
    assert sensor.state == "warning"
    assert sensor.found.startswith("noise ")
    assert "at calibration" in sensor.found


def test_glare() -> None:
    image = unloaded().copy()
    image[100:130, 150:180] = 255
    sensor = judged([image])["sensor"]
    assert sensor.state == "warning"
    assert sensor.found.startswith("glare hides ")
    assert "shade it" in sensor.fix


def test_the_file(tmp_path: Path) -> None:
    config = tmp_path / "s.yaml"
    config.write_text("calibration: c.npz\nsource: {kind: simulated}\n")
    absent, (finding,) = load(load_settings(config))
    assert absent is None
    assert finding.state == "warning"
    assert f"tacshade-edge capture DIR --config {config}" in finding.fix
    assert f"--out {tmp_path}/c.npz" in finding.fix
    (tmp_path / "c.npz").write_bytes(b"PK")
    absent, (finding,) = load(load_settings(config))
    assert (absent, finding.state) == (None, "fault")
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    known, (finding,) = load(load_settings(config))
    assert known is not None
    assert finding.state == "ok"
    assert f"{known.crc32:08x}, 0 days old" in finding.found
    calibration_file.save(tmp_path / "c.npz", calibrated(HALF, 0))
    _, (finding,) = load(load_settings(config))
    assert finding.state == "warning"
    assert "--presses" in finding.fix
    calibration_file.save(tmp_path / "c.npz", fitted_with("balanced", calibrated(HALF)))
    _, (finding,) = load(load_settings(config))
    assert finding.state == "ok"
    assert finding.found.endswith(", depth error after the fit 0.20 mm")
    calibration_file.save(tmp_path / "c.npz", fitted_with("balanced", calibrated(HALF), layout="another"))
    _, (finding,) = load(load_settings(config))
    assert finding.state == "warning"
    assert "the networks for balanced have changed since the fit" in finding.found
    assert "--fit" in finding.fix
    config.write_text("calibration: c.npz\n")
    known, (finding,) = load(load_settings(config))
    assert known is None
    assert "found 640x480 px, expected 320x240 px" in finding.found
