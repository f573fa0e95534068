"""A calibration outlives updates of the program."""

from __future__ import annotations

import json
import logging
import os
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.calibrated_sensor import (
    HALF,
    calibrated,
    pressed,
    presses,
    references,
    sensor_of,
    unloaded,
)
from support.networks import fitted_network, fitted_with
from tacshade_edge.calibration import loading
from tacshade_edge.calibration.calibrate import calibrate, inputs_of, with_new_reference
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.calibration.inputs import Inputs
from tacshade_edge.calibration.reference.references import rezero
from tacshade_edge.camera.file_source import FilesSource
from tacshade_edge.camera.sources import make_source
from tacshade_edge.camera.v4l2 import V4l2Source
from tacshade_edge.cli import main
from tacshade_edge.errors import ConfigError
from tacshade_edge.files import npz
from tacshade_edge.files.npz import Content
from tacshade_edge.lab.simulated_source import SimulatedSource
from tacshade_edge.sensor.inference import network
from tacshade_edge.sensor.inference.network import load_networks
from tacshade_edge.sensor.inference.onnx_weights import values_of, with_values
from tacshade_edge.settings import Files, Simulated, Source, V4l2
from tacshade_edge.types import Calibration

OLDER = calibration_file.VERSION - 1


@cache
def inputs() -> Inputs:
    return inputs_of(sensor_of(HALF), references(), presses()[:10])


@cache
def made() -> Calibration:
    return calibrate(
        inputs().sensor, references(), inputs().presses, networks=load_networks()
    ).calibration


def stored(
    path: Path,
    monkeypatch: pytest.MonkeyPatch,
    inputs: Inputs | None,
    version: int = OLDER,
    calibration: Calibration | None = None,
) -> None:
    """As a program of another version would."""
    calibration = (
        calibration or calibrated()
    )  # made before the version is another: its checksum has it in it
    with monkeypatch.context() as patch:
        patch.setattr(calibration_file, "VERSION", version)
        calibration_file.save(path, calibration, inputs)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "hand.npz"


@pytest.mark.slow
def test_one_of_another_version_is_made_again_and_the_old_file_kept(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    stored(path, monkeypatch, inputs())
    before, expected = path.read_bytes(), calibration_file.with_crc(made())
    with caplog.at_level(logging.INFO):
        found = loading.load(path)
    assert found.crc32 == expected.crc32
    assert found.factors == expected.factors != {}
    kept = path.with_name(f"hand.v{OLDER}.npz")
    assert kept.read_bytes() == before
    assert str(kept) in caplog.messages[-1]
    caplog.clear()
    assert loading.load(path).crc32 == expected.crc32
    assert not caplog.records
    assert calibration_file.inputs_in(path) is not None


@pytest.mark.slow
def test_a_new_reference_is_made_again_too(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images = [unloaded(noise_seed=seed) // 8 * 7 for seed in range(900, 905)]
    stored(path, monkeypatch, with_new_reference(inputs(), images))
    found, expected = loading.load(path, store=False), rezero(made(), images)
    np.testing.assert_array_equal(found.reference_grey, expected.reference_grey)
    assert found.factors == expected.factors


@pytest.mark.slow
def test_it_is_used_where_it_is_not_or_cannot_be_stored(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    stored(path, monkeypatch, Inputs(inputs().sensor, inputs().references))
    before = path.read_bytes()
    assert loading.load(path, store=False).factors == {}
    assert os.listdir(path.parent) == [path.name]
    path.with_name(f"hand.v{OLDER}.npz.part").mkdir()
    assert loading.load(path).crc32
    assert path.read_bytes() == before
    assert (
        "recalibrates at each start because it cannot store the new calibration"
        in caplog.messages[-1]
    )


def test_one_without_what_it_was_made_of_is_read_as_ever(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored(path, monkeypatch, None)
    assert loading.load(path).factors == {}
    stored(path, monkeypatch, None, version=5)
    with pytest.raises(ConfigError, match=r"calibration version 5, expected .*; calibrate again"):
        loading.load(path)


def test_what_can_no_longer_be_used_says_so(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    black = tuple(image * 0 for image in inputs().references)
    stored(path, monkeypatch, Inputs(inputs().sensor, black))
    with pytest.raises(
        ConfigError, match=f"{path}: cannot recalibrate from the file's images: .*; calibrate again"
    ):
        loading.load(path)
    stored(path, monkeypatch, Inputs(inputs().sensor, (black[0][:-2],)))
    with pytest.raises(
        ConfigError, match="cannot read the stored images: found 320x238 px, expected a grey PNG"
    ):
        loading.load(path)


@pytest.mark.slow
def test_fitted_weights_stay_when_it_is_made_again(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored(path, monkeypatch, inputs(), calibration=fitted_with("fast", calibrated()))
    found = loading.load(path)
    assert found.factors == made().factors
    np.testing.assert_array_equal(found.fitted["fast"].weights, fitted_network("fast").weights)
    assert loading.load(path).crc32 == found.crc32
    assert loading.fits_to_renew(path) == ()


@pytest.mark.slow
@pytest.mark.parametrize("version", [OLDER, calibration_file.VERSION])
def test_those_of_another_layout_do_not_run_and_a_new_fit_is_asked_for(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, version: int
) -> None:
    stored(
        path, monkeypatch, inputs(), version, fitted_with("fast", calibrated(), layout="another")
    )
    expected = made() if version == OLDER else calibrated()
    for _ in range(2):
        caplog.clear()
        found = loading.load(path)
        assert found.fitted == {}
        assert found.crc32 == calibration_file.with_crc(expected).crc32
        assert "calibrate --fit again" in caplog.records[-1].message
        assert loading.fits_to_renew(path) == ("fast",)


def test_weights_that_are_not_those_of_their_layout_do_not_run(path: Path) -> None:
    fitted = fitted_network("fast")
    for other in ({"fast": replace(fitted, weights=fitted.weights[1:])}, {"other": fitted}):
        calibration_file.save(path, replace(calibrated(), fitted=other))
        assert loading.load(path).fitted == {}


@pytest.mark.parametrize(
    ("settings", "source"),
    [(V4l2(), V4l2Source), (Files(path="a"), FilesSource), (Simulated(), SimulatedSource)],
)
def test_each_kind_of_source_is_made_from_its_settings(settings: Source, source: type) -> None:
    assert isinstance(make_source(settings), source)


# Written by 1.0 of `HALF`, 2 references and 9 presses, and never again.
STORED = Path(__file__).parents[1] / "golden/calibration-1.0.npz"
VERSION, CRC32 = 8, 976847232
LATER = calibration_file.VERSION + 1


@pytest.fixture
def of_1_0(path: Path) -> Path:
    return Path(shutil.copy(STORED, path))


@pytest.fixture
def later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later version of the program, whose networks have other weights:
    each is a hundredth less.
    """
    weights = shutil.copytree(network.WEIGHTS, tmp_path / "weights")
    for name in ("fast", "balanced", "accurate"):
        data = (weights / f"{name}.onnx").read_bytes()
        (weights / f"{name}.onnx").write_bytes(
            with_values(data, values_of(data) * np.float32(0.99))
        )
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


def test_it_opens_as_it_was_stored(of_1_0: Path) -> None:
    assert calibration_file.version_of(of_1_0) == VERSION
    if calibration_file.VERSION == VERSION:
        assert loading.load(of_1_0).crc32 == CRC32
        assert of_1_0.read_bytes() == STORED.read_bytes()


@pytest.mark.slow
def test_a_version_with_other_networks_recalibrates_by_itself(
    of_1_0: Path, request: pytest.FixtureRequest, caplog: pytest.LogCaptureFixture
) -> None:
    path, kept = of_1_0, of_1_0.with_name(f"hand.v{VERSION}.npz")
    factors = dict(loading.load(path, store=False).factors)
    request.getfixturevalue("later")
    caplog.clear()
    first_mm = depth_mm(path)
    assert f"found version {VERSION}" in caplog.messages[0]
    assert str(kept) in caplog.messages[1]
    assert kept.read_bytes() == STORED.read_bytes()
    # The networks answer less now, and the factors make up for it.
    assert first_mm == pytest.approx(2.0, rel=0.15)
    with np.load(path) as stored:
        new = json.loads(stored["meta"].tobytes())["factors"]
    assert {name: new[name] > factor for name, factor in factors.items()} == dict.fromkeys(
        factors, True
    )
    caplog.clear()
    assert depth_mm(path) == first_mm
    assert caplog.messages == []


@pytest.mark.usefixtures("later")
def test_one_without_its_inputs_opens_too_and_says_what_to_do(
    of_1_0: Path, caplog: pytest.LogCaptureFixture
) -> None:
    content = npz.read(str(of_1_0), "calibration", "calibrate")
    meta = {key: value for key, value in content.meta.items() if key != "inputs"}
    arrays = {
        name: array
        for name, array in content.arrays.items()
        if name not in calibration_file.INPUT_ARRAYS
    }
    of_1_0.write_bytes(Content(meta, arrays).packed())
    assert loading.load(of_1_0).factors == {}
    (line,) = caplog.messages
    assert line == (
        f"{of_1_0}: ignoring the calibration's fit, which belongs to older networks; "
        "calibrate again"
    )
