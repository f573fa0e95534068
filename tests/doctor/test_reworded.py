"""`doctor` chooses a fix by the code of a reason, never by its text."""

from __future__ import annotations

import ssl
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from support.calibrated_sensor import HALF, calibrated, pressed, unloaded
from support.reworded import NONSENSE, reword

from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.devices.fixes import certificate_fix
from tacshade_edge.doctor.calibration import check_images
from tacshade_edge.doctor.camera import check_device, check_frames, check_picture
from tacshade_edge.doctor.capture import Captured
from tacshade_edge.doctor.finding import Finding
from tacshade_edge.errors import DeviceError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.settings import V4l2
from tacshade_edge.simulator import nuisance
from tacshade_edge.types import U8


def _torn(image: U8) -> U8:
    """Half of the skin is upside down; the surround is as it was."""
    torn, skin = image.copy(), disc_mask(*image.shape[:2], calibrated(HALF).geometry.disc)
    skin[: len(image) // 2] = False
    torn[skin] = image[::-1][skin]
    return torn


def _bad_images() -> dict[str, U8]:
    free = unloaded(noise_seed=50)
    calibration = calibrated(HALF)
    disc = calibration.geometry.disc
    glare = free.copy()
    glare[100:130, 150:180] = 255
    surround = free.copy()
    surround[~disc_mask(*free.shape[:2], disc)] = 255
    return {
        "size": np.zeros((480, 640), np.uint8),
        "black": np.zeros(free.shape[:2], np.uint8),
        "saturated": np.full(free.shape[:2], 255, np.uint8),
        "no contrast": np.full(free.shape[:2], 90, np.uint8),
        "noise": np.asarray(np.random.default_rng(1).integers(0, 256, free.shape[:2]), np.uint8),
        "light": (free * 0.35).astype(np.uint8),
        "torn": _torn(pressed("ball", 3.0).image),
        "surround": surround,
        "camera shift": np.roll(free, 4, axis=1),
        "glare": glare,
        "aged": nuisance.gain(free, 0.7),
    }


def _of_images(_machine: Any) -> list[Finding]:
    return [finding for image in _bad_images().values() for finding in check_images(calibrated(HALF), [image], True)]


def _of_pictures(_machine: Any) -> list[Finding]:
    return [check_picture(np.full((120, 160), grey, np.uint8)) for grey in (0, 90, 255)]


def _of_frames(machine: Any) -> list[Finding]:
    error = DeviceError("camera /dev/video0: no frame within 2.0 s", code=ReasonCode.STALLED)
    return list(check_frames(V4l2(), Captured(error=error.reason), machine, ""))


def _of_a_node(machine: Any) -> list[Finding]:
    machine.put("/dev/video0")
    return list(check_device(V4l2(), machine))


@pytest.mark.parametrize(
    "check", [pytest.param(_of_images, marks=pytest.mark.slow), _of_pictures, _of_frames, _of_a_node]
)
def test_a_reworded_reason_has_the_same_fix(
    machine: Any, monkeypatch: pytest.MonkeyPatch, check: Callable[[Any], list[Finding]]
) -> None:
    before = check(machine)
    reword(monkeypatch)
    after = check(machine)
    fixes = [(finding.check, finding.state, finding.fix) for finding in before]
    assert [(finding.check, finding.state, finding.fix) for finding in after] == fixes
    assert any(NONSENSE in finding.found for finding in after)
    assert not any(NONSENSE in finding.found for finding in before)


@pytest.mark.slow
def test_each_bad_image_has_a_fix_of_its_own() -> None:
    fixes = {
        name: next(finding.fix for finding in check_images(calibrated(HALF), [image], True) if finding.fix)
        for name, image in _bad_images().items()
    }
    assert len(set(fixes.values())) == len(fixes), fixes


@pytest.mark.parametrize(
    ("code", "fix"),
    [
        (10, "check this machine's clock"),
        (9, "check this machine's clock"),
        (62, "set mqtt.host to a name in"),
        (64, "set mqtt.host"),
        (18, "set mqtt.ca_file"),
    ],
)
def test_a_refused_certificate_is_told_apart_by_openssls_number(code: int, fix: str) -> None:
    error = ssl.SSLCertVerificationError()
    error.verify_code, error.verify_message = code, NONSENSE
    assert certificate_fix(error, "broker.local").startswith(fix)
