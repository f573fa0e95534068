"""A calibration that 1.0 wrote opens with every later version, whatever networks that one ships.

`calibration-1.0.npz` is of `calibrated_sensor.HALF`, of 2 references and 9 presses. It is never written again.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.calibrated_sensor import pressed

from tacshade_edge.cli import main
from tacshade_edge.factories import calibrations
from tacshade_edge.inference import network
from tacshade_edge.inference.onnx_weights import values_of, with_values
from tacshade_edge.storage import npz
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.npz import Content

STORED = Path(__file__).parents[1] / "golden/calibration-1.0.npz"
VERSION, CRC32 = 8, 976847232
LATER = calibration_file.VERSION + 1


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return Path(shutil.copy(STORED, tmp_path / "hand.npz"))


@pytest.fixture
def factors(tmp_path: Path) -> dict[str, float]:
    """The factors of the stored presses with the networks of today."""
    path = Path(shutil.copy(STORED, tmp_path / "today.npz"))
    return dict(calibrations.load(path).factors)


@pytest.fixture
def later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later version of the program, whose networks have other weights: each is a hundredth less."""
    weights = shutil.copytree(network.WEIGHTS, tmp_path / "weights")
    for name in ("fast", "balanced", "accurate"):
        data = (weights / f"{name}.onnx").read_bytes()
        (weights / f"{name}.onnx").write_bytes(with_values(data, values_of(data) * np.float32(0.99)))
    monkeypatch.setattr(network, "WEIGHTS", weights)
    monkeypatch.setattr(calibration_file, "VERSION", LATER)


def depth_mm(path: Path) -> float:
    """Of a press 2 mm deep, by the command."""
    cv2.imwrite(str(path.with_name("press.png")), pressed("ball", 2.0).image)
    out = path.with_name("out")
    words = ["reconstruct", "--calibration", path, "--out", out, path.with_name("press.png")]
    assert main([str(word) for word in words]) == 0
    (record,) = json.loads((out / "summary.json").read_text())
    return float(record["depth_max_mm"])


def test_it_opens_as_it_was_stored(path: Path) -> None:
    assert calibration_file.version_of(path) == VERSION
    if calibration_file.VERSION == VERSION:
        assert calibrations.load(path).crc32 == CRC32
        assert path.read_bytes() == STORED.read_bytes()


@pytest.mark.slow
def test_a_version_with_other_networks_recalibrates_by_itself(
    factors: dict[str, float], later: None, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.clear()
    kept = path.with_name(f"hand.v{VERSION}.npz")
    first_mm = depth_mm(path)
    assert f"found version {VERSION}" in caplog.messages[0]
    assert str(kept) in caplog.messages[1]
    assert kept.read_bytes() == STORED.read_bytes()
    # The networks answer less now, and the factors make up for it.
    assert first_mm == pytest.approx(2.0, rel=0.15)
    with np.load(path) as npz:
        new = json.loads(npz["meta"].tobytes())["factors"]
    assert {name: new[name] > factor for name, factor in factors.items()} == dict.fromkeys(factors, True)
    caplog.clear()
    assert depth_mm(path) == first_mm
    assert caplog.messages == []


@pytest.mark.usefixtures("later")
def test_one_without_its_inputs_opens_too_and_says_what_to_do(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    content = npz.read(str(path), "calibration", "calibrate")
    meta = {key: value for key, value in content.meta.items() if key != "inputs"}
    arrays = {name: array for name, array in content.arrays.items() if name not in calibration_file.INPUT_ARRAYS}
    path.write_bytes(Content(meta, arrays).packed())
    assert calibrations.load(path).factors == {}
    (line,) = caplog.messages
    assert line == f"{path}: ignoring the calibration's fit, which belongs to older networks; calibrate again"
