from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.calibrated_sensor import calibrated
from support.fitted import fitted_with

from tacshade_edge.errors import ConfigError
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.calibration.fitted_networks import pack, unpack
from tacshade_edge.types import FittedNetwork

FITTED = {
    "fast": FittedNetwork(
        "a1", np.arange(5, dtype=np.float32), np.ones((2, 3, 3), np.float32), 8, error_mm=0.2, shipped_error_mm=0.4
    )
}


def assert_same(found: FittedNetwork, expected: FittedNetwork) -> None:
    np.testing.assert_array_equal(found.weights, expected.weights)
    np.testing.assert_array_equal(found.correction, expected.correction)
    for name in ("layout", "held_out", "error_mm", "shipped_error_mm", "error_scale"):
        assert getattr(found, name) == getattr(expected, name)


def test_what_is_packed_comes_back() -> None:
    found = unpack(*pack(FITTED))
    assert set(found) == {"fast"}
    assert_same(found["fast"], FITTED["fast"])
    scaled = replace(FITTED["fast"], error_scale=1.5)
    assert_same(unpack(*pack({"fast": scaled}))["fast"], scaled)
    assert unpack({}, {}) == {}


@pytest.mark.parametrize(
    "damage",
    [
        {"correction": [0, 3, 3]},
        {"correction": [2, 3, 4]},
        {"correction": [2, 3]},
        {"layout": 1},
        {"more": 1},
        {"error_scale": 0.0},
    ],
)
def test_what_cannot_be_is_refused(damage: dict[str, object]) -> None:
    meta, arrays = pack(FITTED)
    with pytest.raises(ValueError, match=r"[Ee]xpected|unknown field|no sensor has"):
        unpack({"fast": {**meta["fast"], **damage}}, arrays)
    with pytest.raises(ValueError, match="expected fitted weights"):
        unpack(meta, {})


def test_weights_are_finite() -> None:
    with pytest.raises(ValueError, match="not finite"):
        FittedNetwork("a1", np.full(5, np.nan, np.float32), np.ones((1, 1, 1), np.float32), 8, 0.2, 0.4)


def test_a_calibration_keeps_them_and_they_count_in_its_checksum(tmp_path: Path) -> None:
    path = tmp_path / "c.npz"
    fitted = fitted_with("fast", calibrated())
    stored = calibration_file.save(path, fitted)
    loaded = calibration_file.load(path)
    assert loaded.crc32 == stored.crc32 != calibrated().crc32
    assert_same(loaded.fitted["fast"], fitted.fitted["fast"])
    assert_same(calibration_file.fitted_in(path)["fast"], fitted.fitted["fast"])
    calibration_file.save(path, calibrated())
    assert calibration_file.load(path).crc32 == calibrated().crc32
    assert calibration_file.fitted_in(path) == {}


def test_a_file_whose_weights_are_not_as_many_as_said_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "c.npz"
    with monkeypatch.context() as patch:
        patch.setattr(calibration_file.fitted_networks, "pack", lambda fitted: (pack(fitted)[0], {}))
        calibration_file.save(path, fitted_with("fast", calibrated()))
    for read in (calibration_file.load, calibration_file.fitted_in):
        with pytest.raises(ConfigError, match="expected fitted weights as many as they are said to be"):
            read(path)
