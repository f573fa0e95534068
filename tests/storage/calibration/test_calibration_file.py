from __future__ import annotations

import json
import math
import os
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.calibrated_sensor import calibrated
from support.examples import at_most

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.types import Calibration, Fit, ProfileFit
from tools.testbed.painted_sensor import painted_calibration


def assert_same(one: Calibration, other: Calibration) -> None:
    for field in fields(Calibration):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        else:
            assert a == b, field.name


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Calibration, bytes]:
    path = tmp_path_factory.mktemp("calibration") / "cal.npz"
    calibration = calibration_file.save(path, painted_calibration())
    return path, calibration, path.read_bytes()


@pytest.mark.slow
def test_what_is_stored_comes_back(tmp_path: Path) -> None:
    for k, calibration in enumerate(
        (
            calibrated(),
            calibrated(count=0),
            replace(painted_calibration(), error_scales={"fast": 1.25, "balanced": 0.5}),
            replace(painted_calibration(), flange_T_sensor=(1.5, -2.0, 30.0, 0.6, 0.0, 0.8, 0.0)),
            replace(painted_calibration(), geometry=replace(painted_calibration().geometry, camera_distance_mm=None)),
        )
    ):
        path = tmp_path / f"{k}.npz"
        saved = calibration_file.save(path, calibration)
        assert saved.crc32 != 0
        loaded = calibration_file.load(path)
        assert_same(loaded, saved)
        assert_same(replace(loaded, crc32=0), replace(calibration, crc32=0))
        assert not loaded.reference_white.flags.writeable


def test_the_fit_is_stored_under_flat_keys(tmp_path: Path) -> None:
    """As in every file of this version, so that old files load and keep their checksum."""
    flat = {
        "presses": 20.0,
        "agreement_mae_mm": 0.1,
        "position_mae_mm": 0.5,
        "accurate_presses": 19.0,
        "accurate_depth_mae_mm": 0.2,
        "accurate_depth_worst_mm": 0.6,
    }
    fit = Fit(20, 0.1, 0.5, {"accurate": ProfileFit(19, 0.2, 0.6)})
    for stored, expected in ((fit, flat), (None, {})):
        path = tmp_path / "cal.npz"
        saved = calibration_file.save(path, replace(painted_calibration(), fit=stored))
        with np.load(path) as npz:
            assert json.loads(npz["meta"].tobytes())["fit"] == expected
        assert calibration_file.load(path).fit == stored
        assert calibration_file.load(path).crc32 == saved.crc32


def test_the_checksum_is_of_the_content_alone(tmp_path: Path) -> None:
    first = calibration_file.save(tmp_path / "a.npz", painted_calibration())
    second = calibration_file.save(tmp_path / "b.npz", calibration_file.load(tmp_path / "a.npz"))
    assert first.crc32 == second.crc32 == calibration_file.with_crc(painted_calibration()).crc32
    other = replace(painted_calibration(), noise_grey=0.51)
    assert calibration_file.with_crc(other).crc32 != first.crc32


def refused_or_same(path: Path, original: Calibration) -> None:
    """A damaged file is refused in one line, or the damage was in bytes that carry nothing."""
    try:
        loaded = calibration_file.load(path)
    except ConfigError as error:
        assert str(path) in str(error)  # noqa: PT017
        assert "\n" not in str(error)  # noqa: PT017
        return
    assert_same(loaded, original)


@settings(max_examples=at_most(150), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_flipped_bit_is_found(stored: tuple[Path, Calibration, bytes], data: st.DataObject) -> None:
    path, calibration, content = stored
    at = data.draw(st.integers(0, len(content) - 1))
    flip = data.draw(st.integers(1, 255))
    damaged = path.with_name("flipped.npz")
    damaged.write_bytes(content[:at] + bytes([content[at] ^ flip]) + content[at + 1 :])
    refused_or_same(damaged, calibration)


@pytest.mark.slow
def test_every_flipped_byte_is_found(stored: tuple[Path, Calibration, bytes]) -> None:
    path, calibration, content = stored
    damaged = path.with_name("every.npz")
    for at in range(len(content)):
        damaged.write_bytes(content[:at] + bytes([content[at] ^ (0x01, 0x80, 0xFF)[at % 3]]) + content[at + 1 :])
        refused_or_same(damaged, calibration)


@pytest.mark.parametrize("part", [0.0, 0.001, 0.1, 0.5, 0.9, 0.99, 0.999])
def test_a_cut_file_is_refused(stored: tuple[Path, Calibration, bytes], part: float) -> None:
    path, _, content = stored
    cut = path.with_name("cut.npz")
    cut.write_bytes(content[: int(part * len(content))])
    with pytest.raises(ConfigError, match=r"cut\.npz: .*expected a file written by"):
        calibration_file.load(cut)


def test_what_is_no_calibration_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("hello")
    np.savez(tmp_path / "other.npz", height_mm=np.zeros(3))
    np.save(tmp_path / "array.npy", np.zeros(3))
    np.savez(tmp_path / "pickled.npz", meta=np.array([{"a": 1}], dtype=object))
    for name in ("text.npz", "other.npz", "array.npy", "pickled.npz", "none.npz", "."):
        with pytest.raises(ConfigError) as refusal:
            calibration_file.load(tmp_path / name)
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "value"), [("alpha", math.nan), ("noise_grey", math.inf), ("pitch_px", 0.0), ("factors", {"fast": 1e39})]
)
def test_numbers_that_no_sensor_has_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, value: object
) -> None:
    changed = {name: value}
    with pytest.raises(ValueError, match="which no sensor has"):
        replace(painted_calibration(), **changed)  # type: ignore[arg-type]
    monkeypatch.setattr("tacshade_edge.types.calibration._check_numbers", lambda calibration: None)
    calibration_file.save(tmp_path / "odd.npz", replace(painted_calibration(), **changed))  # type: ignore[arg-type]
    monkeypatch.undo()
    with pytest.raises(ConfigError, match=rf"odd\.npz: {'factor of fast' if name == 'factors' else name} is "):
        calibration_file.load(tmp_path / "odd.npz")


def test_another_version_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = calibration_file.VERSION
    monkeypatch.setattr(calibration_file, "VERSION", now + 1)
    calibration_file.save(tmp_path / "new.npz", painted_calibration())
    monkeypatch.undo()
    with pytest.raises(
        ConfigError, match=rf"new\.npz: found calibration version {now + 1}, expected {now}; calibrate again"
    ):
        calibration_file.load(tmp_path / "new.npz")


@pytest.mark.parametrize("version", range(calibration_file.OLDEST, calibration_file.VERSION))
def test_one_fitted_to_the_networks_before_is_read_without_its_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, version: int
) -> None:
    fitted = replace(painted_calibration(), factors={"fast": 1.2, "accurate": 0.9})
    assert fitted.fit is not None
    monkeypatch.setattr(calibration_file, "VERSION", version)
    calibration_file.save(tmp_path / "old.npz", fitted)
    calibration_file.save(tmp_path / "unfitted.npz", replace(fitted, factors={}, fit=None))
    monkeypatch.undo()
    loaded = calibration_file.load(tmp_path / "old.npz")
    assert (loaded.factors, loaded.fit) == ({}, None)
    assert (loaded.geometry, loaded.crc32 != 0) == (fitted.geometry, True)
    np.testing.assert_array_equal(loaded.reference_white, fitted.reference_white)
    (said,) = caplog.messages
    assert said.endswith("old.npz: ignoring the calibration's fit, which belongs to older networks; calibrate again")
    caplog.clear()
    assert calibration_file.load(tmp_path / "unfitted.npz").factors == {}
    assert not caplog.messages


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"none/cal\.npz: cannot write the calibration: No such file"):
        calibration_file.save(tmp_path / "none" / "cal.npz", painted_calibration())
    (tmp_path / "file").touch()
    with pytest.raises(DeviceError, match="cannot write"):
        calibration_file.save(tmp_path / "file" / "cal.npz", painted_calibration())


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "cal.npz"
    old = calibration_file.save(path, painted_calibration())

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DeviceError, match="No space left"):
        calibration_file.save(path, replace(painted_calibration(), alpha=16.0))
    assert_same(calibration_file.load(path), old)
    assert os.listdir(tmp_path) == ["cal.npz"]
