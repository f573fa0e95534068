from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.storage.calibration import calibration_file, reference_file
from tacshade_edge.storage.calibration.calibration_file import with_crc
from tacshade_edge.storage.calibration.reference_file import StoredReference, belongs_to, path_beside
from tacshade_edge.storage.npz import Content
from tools.testbed.painted_sensor import painted_calibration

CALIBRATED = painted_calibration()
ARRAYS = {"reference_white": CALIBRATED.reference_white, "reference_grey": CALIBRATED.reference_grey // 2}
TAKEN = StoredReference(with_crc(replace(CALIBRATED, **ARRAYS, noise_grey=0.75)), 1_700_000_000_123_456_789)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return path_beside(tmp_path / "calibration.npz")


def test_what_is_stored_comes_back_and_nothing_where_nothing_is(path: Path) -> None:
    assert path.name == "calibration.reference.npz"
    assert reference_file.load(path, CALIBRATED) is None
    reference_file.save(path, CALIBRATED, TAKEN)
    stored = reference_file.load(path, CALIBRATED)
    assert stored is not None
    assert stored.wall_ns == TAKEN.wall_ns
    assert stored.calibration.crc32 == TAKEN.calibration.crc32 != CALIBRATED.crc32
    assert stored.calibration.noise_grey == 0.75
    np.testing.assert_array_equal(stored.calibration.reference_grey, TAKEN.calibration.reference_grey)
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_that_of_another_calibration_has_its_own_code(path: Path) -> None:
    reference_file.save(path, CALIBRATED, TAKEN)
    with pytest.raises(ConfigError, match=f"{path}: the stored reference belongs to another calibration") as caught:
        reference_file.load(path, with_crc(replace(CALIBRATED, reference_grey=CALIBRATED.reference_grey // 2)))
    assert caught.value.code is ReasonCode.CALIBRATION_CHANGED


def test_it_stays_when_a_calibration_is_made_again_on_the_same_images(path: Path) -> None:
    reference_file.save(path, CALIBRATED, TAKEN)
    again = with_crc(replace(CALIBRATED, alpha=16.0, factors={"fast": 1.1}))
    stored = reference_file.load(path, again)
    assert stored is not None
    assert stored.calibration.factors == {"fast": 1.1}
    np.testing.assert_array_equal(stored.calibration.reference_grey, TAKEN.calibration.reference_grey)


def test_a_calibration_is_no_reference(path: Path) -> None:
    calibration_file.save(path, CALIBRATED)
    with pytest.raises(ConfigError, match="not a version 2 reference file"):
        reference_file.load(path, CALIBRATED)


META = {"version": 2, "belongs_to": belongs_to(CALIBRATED), "wall_ns": 5, "noise_grey": 0.5}


@pytest.mark.parametrize(
    ("meta", "arrays"),
    [
        ({**META, "version": 1}, ARRAYS),
        ({**META, "noise_grey": None}, ARRAYS),
        ({**META, "noise_grey": -1.0}, ARRAYS),
        ({**META, "noise_grey": float("nan")}, ARRAYS),
        ({**META, "wall_ns": "now"}, ARRAYS),
        ({}, ARRAYS),
        (META, {}),
        (META, {**ARRAYS, "more": np.zeros(3)}),
        (META, {**ARRAYS, "reference_grey": ARRAYS["reference_grey"][:-1]}),
        (META, {**ARRAYS, "reference_grey": ARRAYS["reference_grey"].astype(np.float32)}),
    ],
)
def test_what_cannot_be_one_is_refused_in_one_line(
    path: Path, meta: dict[str, object], arrays: dict[str, object]
) -> None:
    path.write_bytes(Content(meta, arrays).packed())
    with pytest.raises(ConfigError, match=f"{path}: .*take a new ") as caught:
        reference_file.load(path, CALIBRATED)
    assert "\n" not in str(caught.value)


def test_other_files_and_none_that_can_be_read(path: Path) -> None:
    for content in (b"", b"hello", b"PK\x03\x04" * 9):
        path.write_bytes(content)
        with pytest.raises(ConfigError, match="reference"):
            reference_file.load(path, CALIBRATED)
    path.unlink()
    path.mkdir()
    with pytest.raises(ConfigError, match="cannot read the stored reference"):
        reference_file.load(path, CALIBRATED)


def test_a_folder_that_is_not_there_is_said(path: Path) -> None:
    with pytest.raises(DeviceError, match="cannot write it: No such file or directory") as caught:
        reference_file.save(path.parent / "gone" / path.name, CALIBRATED, TAKEN)
    assert caught.value.code is ReasonCode.DISK
