from __future__ import annotations

import logging
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tacshade_edge.daemon.references import requested, restored
from tacshade_edge.errors import ConfigError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.storage.calibration.calibration_file import with_crc
from tacshade_edge.types import Calibration

IMAGES = 10


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "calibration.reference.npz"


def test_what_was_requested_is_restored(
    calibration: Calibration, pictures: Any, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    before_ns = time.time_ns()
    taken = requested(calibration, [pictures.free // 2 + 20] * IMAGES, path)
    assert taken.reason is None
    assert taken.calibration.crc32 not in (0, calibration.crc32)
    again = restored(calibration, path)
    assert again.as_dict() == taken.as_dict()
    assert again.as_dict()["origin"] == "request"
    assert again.wall_ns is not None
    assert before_ns <= again.wall_ns <= time.time_ns()
    assert again.calibrated is calibration
    assert [record.levelname for record in caplog.records] == ["INFO", "INFO"]


def test_without_a_stored_one_it_is_the_calibrations(
    calibration: Calibration, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    origin = restored(calibration, path)
    assert origin.calibration is calibration
    assert origin.as_dict() == {
        **{"origin": "calibration", "wall_ns": None, "calibration_crc32": calibration.crc32},
        **{"reason": "", "reason_code": ""},
    }
    assert caplog.records == []


def test_another_calibration_makes_it_void_and_says_so_once(
    calibration: Calibration, pictures: Any, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    requested(calibration, [pictures.free] * IMAGES, path)
    newer = with_crc(replace(calibration, reference_grey=calibration.reference_grey // 2))
    void = restored(newer, path)
    assert void.calibration is newer
    assert void.reason is not None
    assert void.reason.code is ReasonCode.CALIBRATION_CHANGED
    assert restored(newer, path).reason is None
    (warning,) = caplog.records
    assert warning.getMessage().endswith(
        "belongs to another calibration; take a new reference; using the calibration's own reference"
    )
    assert not path.exists()


def test_a_damaged_one_is_told_and_left_alone(
    calibration: Calibration, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path.write_bytes(b"not of ours")
    for _ in range(2):
        origin = restored(calibration, path)
        assert origin.calibration is calibration
        assert origin.reason is not None
        assert origin.reason.code is ReasonCode.CONFIG
    assert path.read_bytes() == b"not of ours"
    assert [record.levelname for record in caplog.records] == ["WARNING", "WARNING"]


def test_a_folder_that_cannot_be_written_is_told(calibration: Calibration, pictures: Any, tmp_path: Path) -> None:
    taken = requested(calibration, [pictures.free] * IMAGES, tmp_path / "gone" / "c.reference.npz")
    assert taken.calibration.crc32 != 0
    assert taken.reason is not None
    assert taken.reason.code is ReasonCode.DISK
    assert taken.reason.text.endswith("this reference lasts only until the next start or reload")


def test_images_that_cannot_be_used_store_nothing(calibration: Calibration, pictures: Any, path: Path) -> None:
    with pytest.raises(ConfigError):
        requested(calibration, [pictures.black] * IMAGES, path)
    assert not path.exists()
