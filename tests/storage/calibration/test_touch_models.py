from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacshade_edge.core.touch.learning import learn
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.calibration.touch_models import pack, unpack
from tacshade_edge.types import TOUCH_ARRAYS, TouchModel
from tools.testbed.painted_sensor import painted_calibration

FEATURES = np.random.default_rng(0).normal(size=(60, 20)).astype(np.float32)


@pytest.fixture(scope="module")
def model() -> TouchModel:
    labels = FEATURES[:, :2].astype(np.float64)
    found = learn(FEATURES, FEATURES[:, :7], ("depth_mm", "force_z_n"), labels, np.arange(60), "ab").model
    assert found is not None
    return found


def same(one: TouchModel, other: TouchModel) -> bool:
    numbers = ("names", "networks", "scale", "width", "leverage_max", "residual_max")
    arrays = all(np.array_equal(getattr(one, name), getattr(other, name)) for name in TOUCH_ARRAYS)
    return arrays and all(getattr(one, name) == getattr(other, name) for name in numbers)


def test_what_is_stored_comes_back(model: TouchModel, tmp_path: Path) -> None:
    calibration = replace(painted_calibration(), touch={"fast": model})
    stored = calibration_file.save(tmp_path / "c.npz", calibration)
    found = calibration_file.load(tmp_path / "c.npz")
    assert same(found.touch["fast"], model)
    assert found.crc32 == stored.crc32 != calibration_file.with_crc(painted_calibration()).crc32
    assert same(calibration_file.touch_in(tmp_path / "c.npz")["fast"], model)


def test_without_models_the_checksum_is_as_before(tmp_path: Path) -> None:
    stored = calibration_file.save(tmp_path / "c.npz", painted_calibration())
    assert stored.crc32 == calibration_file.with_crc(replace(painted_calibration(), touch={})).crc32


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"names": ["depth_mm", "colour"]}, "other arrays or quantities"),
        ({"names": ["depth_mm"]}, "expected"),
        ({"shapes": {}}, "other arrays or quantities"),
        ({"width": 0.0}, "not above 0"),
        ({"leverage_max": float("nan")}, "not above 0"),
        ({"scale": "large"}, "Expected"),
        ({"more": 1}, "unknown field"),
    ],
)
def test_what_cannot_be_is_refused(model: TouchModel, change: dict[str, Any], message: str) -> None:
    meta, arrays = pack({"fast": model})
    with pytest.raises(ValueError, match=message):
        unpack({"fast": {**meta["fast"], **change}}, arrays)


def test_damaged_arrays_are_refused(model: TouchModel) -> None:
    meta, arrays = pack({"fast": model})
    for name, array in arrays.items():
        with pytest.raises(ValueError, match="as large as"):
            unpack(meta, {**arrays, name: array[:-1]})
        with pytest.raises(ValueError, match="not finite"):
            unpack(meta, {**arrays, name: np.full_like(array, np.nan)})
    with pytest.raises(ValueError, match="as large as"):
        unpack(meta, {})
    shapes = {**meta["fast"]["shapes"], "centres": [3, 3]}
    with pytest.raises(ValueError, match=r"expected|as large as"):
        unpack({"fast": {**meta["fast"], "shapes": shapes}}, arrays)
