from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.calibrated_sensor import HALF, calibrated, pressed, unloaded
from support.findings import checked, states
from support.networks import fitted_with
from support.painted_sensor import painted_calibration
from support.published_sensor import unmeasured
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.doctor.calibration_check import check_images, load
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.settings import load as load_settings
from tacshade_edge.types import U8, Frame, Reconstruction

ROWS, COLS = 240, 320


@cache
def free(count: int = 5) -> list[U8]:
    return [unloaded(noise_seed=50 + k) for k in range(count)]


def closer(image: U8) -> U8:
    zoom = cv2.getRotationMatrix2D((COLS / 2, ROWS / 2), 0, 1.03)
    return np.asarray(cv2.warpAffine(image, zoom, (COLS, ROWS)), np.uint8)


def glaring() -> U8:
    image = unloaded().copy()
    image[100:130, 150:180] = 255
    return image


def torn() -> U8:
    image = pressed("ball", 3.0).image
    skin = disc_mask(ROWS, COLS, calibrated(HALF).geometry.disc)
    skin[: ROWS // 2] = False
    return np.where(skin[..., None], image[::-1], image)


CASES: dict[str, tuple[Callable[[], Sequence[U8]], str, str]] = {
    "as calibrated": (free, "ok", ""),
    "aged": (lambda: [camera_faults.gain(image, 0.7) for image in free()], "warning", "--rezero"),
    "pressed": (lambda: [pressed("ball", 3.0).image], "warning", "nothing is touching the skin"),
    "shaking": (
        lambda: [np.roll(image, k % 2, axis=1) for k, image in enumerate(free(6))],
        "warning",
        "shaking",
    ),
    "glare": (lambda: [glaring()], "warning", "shade it"),
    "torn": (lambda: [torn()], "fault", "cable"),
    "moved": (
        lambda: [np.roll(image, 4, axis=1) for image in free()],
        "fault",
        "fasten the camera",
    ),
    "black": (lambda: [np.zeros((ROWS, COLS), np.uint8)], "fault", "switch the sensor's light on"),
    "size": (lambda: [np.zeros((480, 640), np.uint8)], "fault", "set source.width_px"),
    "saturated": (
        lambda: [np.full((ROWS, COLS), 255, np.uint8)],
        "fault",
        "dim the sensor's light",
    ),
    "dark": (lambda: [(unloaded() * 0.35).astype(np.uint8)], "fault", "restore the light"),
}


@pytest.mark.parametrize("name", CASES)
def test_images(name: str) -> None:
    images, state, fix = CASES[name]
    found = {
        finding.check: finding
        for finding in checked(check_images(calibrated(HALF), images(), live=True))
    }
    assert found["sensor"].state == state
    assert fix in found["sensor"].fix


def test_a_camera_that_came_closer_and_files_that_show_presses() -> None:
    found = check_images(calibrated(HALF), [closer(image) for image in free()], live=True)
    place = next(finding for finding in found if finding.check == "camera place")
    assert place.state == "warning"
    assert "move it back" in place.fix
    assert (
        states(check_images(calibrated(HALF), [pressed("ball", 3.0).image], live=False))[-1] == "ok"
    )


class Feels:
    """A reconstructor that finds a touch of unknown depth in every frame."""

    def step(self, frame: Frame) -> Reconstruction:
        return unmeasured(frame.seq)


def test_a_touch_of_unknown_depth_is_no_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "tacshade_edge.doctor.calibration_check.make_reconstructor", lambda *_: Feels()
    )
    live, shown = (check_images(calibrated(HALF), free(), live=live)[-1] for live in (True, False))
    assert (live.state, shown.state) == ("warning", "ok")
    assert "its depth is unknown" in live.found
    assert shown.found.endswith("shows a touch of unknown depth")


def test_the_file(tmp_path: Path) -> None:
    config, path = tmp_path / "s.yaml", tmp_path / "c.npz"
    config.write_text("calibration: c.npz\nsource: {kind: simulated}\n")
    absent, (finding,) = load(load_settings(config))
    assert (absent, finding.state) == (None, "warning")
    assert f"tacshade-edge capture DIR --config {config}" in finding.fix
    assert f"--out {path}" in finding.fix
    path.write_bytes(b"PK")
    absent, (finding,) = load(load_settings(config))
    assert (absent, finding.state) == (None, "fault")
    for made, state, fix in (
        (painted_calibration(), "ok", ""),
        (calibrated(HALF, 0), "warning", "--presses"),
        (fitted_with("balanced", calibrated(HALF)), "ok", ""),
        (fitted_with("balanced", calibrated(HALF), layout="another"), "warning", "--fit"),
    ):
        calibration_file.save(path, made)
        known, (finding,) = load(load_settings(config))
        assert known is not None
        assert finding.state == state
        assert f"{known.crc32:08x}" in finding.found
        assert fix in finding.fix
    config.write_text("calibration: c.npz\nsource: {kind: v4l2, width_px: 800, height_px: 600}\n")
    known, (finding,) = load(load_settings(config))
    assert (known, finding.state) == (None, "fault"), "another image size"
