"""A calibration outlives updates of the program."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.calibrated_sensor import HALF, calibrated, presses, references, sensor_of, unloaded
from support.networks import fitted_network, fitted_with

from tacshade_edge.core.calibration.calibrate import calibrate, inputs_of, with_new_reference
from tacshade_edge.core.calibration.inputs import Inputs
from tacshade_edge.core.calibration.reference.references import rezero
from tacshade_edge.devices.camera.simulated import SimulatedSource
from tacshade_edge.devices.camera.v4l2 import V4l2Source
from tacshade_edge.errors import ConfigError
from tacshade_edge.factories import calibrations
from tacshade_edge.factories.sources import SOURCES, make_source
from tacshade_edge.inference.network import load_networks
from tacshade_edge.settings import Files, Settings, Simulated, Source, V4l2
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.recording.image_source import FilesSource
from tacshade_edge.types import Calibration

OLDER = calibration_file.VERSION - 1


@cache
def inputs() -> Inputs:
    return inputs_of(sensor_of(HALF), references(), presses())


def made() -> Calibration:
    return calibrate(inputs().sensor, references(), presses(), networks=load_networks()).calibration


def stored(path: Path, monkeypatch: pytest.MonkeyPatch, inputs: Inputs | None, version: int = OLDER) -> None:
    """As a program of another version would."""
    saved(path, monkeypatch, calibrated(), inputs, version)


def saved(
    path: Path, monkeypatch: pytest.MonkeyPatch, calibration: Calibration, inputs: Inputs | None, version: int
) -> None:
    """Made before, as tests share it: its checksum has the version in it."""
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
        found = calibrations.load(path)
    assert found.crc32 == expected.crc32
    assert found.factors == expected.factors != {}
    kept = path.with_name(f"hand.v{OLDER}.npz")
    assert kept.read_bytes() == before
    assert [record.message for record in caplog.records] == [
        f"{path}: found version {OLDER}, expected {calibration_file.VERSION}; recalibrating from the file's images",
        f"{path}: recalibrated from the file's images and kept the old file as {kept}",
    ]
    caplog.clear()
    assert calibrations.load(path).crc32 == expected.crc32
    assert not caplog.records
    assert calibration_file.inputs_in(path) is not None


@pytest.mark.slow
def test_a_new_reference_is_made_again_too(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images = [unloaded(noise_seed=seed) // 8 * 7 for seed in range(900, 905)]
    stored(path, monkeypatch, with_new_reference(inputs(), images))
    found, expected = calibrations.load(path, store=False), rezero(made(), images)
    np.testing.assert_array_equal(found.reference_grey, expected.reference_grey)
    assert found.factors == expected.factors


@pytest.mark.slow
def test_nothing_is_written_where_that_is_not_wanted(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stored(path, monkeypatch, Inputs(inputs().sensor, inputs().references))
    before = path.read_bytes()
    assert calibrations.load(path, store=False).factors == {}
    assert path.read_bytes() == before
    assert os.listdir(path.parent) == [path.name]


@pytest.mark.slow
def test_it_is_used_where_it_cannot_be_stored(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    stored(path, monkeypatch, Inputs(inputs().sensor, inputs().references))
    before = path.read_bytes()
    path.with_name(f"hand.v{OLDER}.npz.part").mkdir()
    assert calibrations.load(path).crc32
    assert path.read_bytes() == before
    assert "recalibrates at each start because it cannot store the new calibration" in caplog.messages[-1]


def test_one_without_what_it_was_made_of_is_read_as_ever(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stored(path, monkeypatch, None)
    assert calibrations.load(path).factors == {}
    stored(path, monkeypatch, None, 5)
    with pytest.raises(ConfigError, match=r"calibration version 5, expected .*; calibrate again"):
        calibrations.load(path)


def test_what_can_no_longer_be_used_says_so(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    black = tuple(image * 0 for image in inputs().references)
    stored(path, monkeypatch, Inputs(inputs().sensor, black))
    with pytest.raises(ConfigError, match=f"{path}: cannot recalibrate from the file's images: .*; calibrate again"):
        calibrations.load(path)
    stored(path, monkeypatch, Inputs(inputs().sensor, (black[0][:-2],)))
    with pytest.raises(ConfigError, match="cannot read the stored images: found 320x238 px, expected a grey PNG"):
        calibrations.load(path)


@pytest.mark.slow
def test_fitted_weights_stay_when_it_is_made_again(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved(path, monkeypatch, fitted_with("fast", calibrated()), inputs(), OLDER)
    found = calibrations.load(path)
    assert found.factors == made().factors
    np.testing.assert_array_equal(found.fitted["fast"].weights, fitted_network("fast").weights)
    assert calibrations.load(path).crc32 == found.crc32
    assert calibrations.fits_to_renew(path) == ()


@pytest.mark.slow
@pytest.mark.parametrize("version", [OLDER, calibration_file.VERSION])
def test_those_of_another_layout_do_not_run_and_a_new_fit_is_asked_for(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, version: int
) -> None:
    saved(path, monkeypatch, fitted_with("fast", calibrated(), layout="another"), inputs(), version)
    for _ in range(2):
        caplog.clear()
        found = calibrations.load(path)
        assert found.fitted == {}
        assert found.crc32 == calibration_file.with_crc(made()).crc32
        assert "calibrate --fit again" in caplog.records[-1].message
        assert calibrations.fits_to_renew(path) == ("fast",)


def test_weights_that_are_not_those_of_their_layout_do_not_run(path: Path) -> None:
    network = fitted_network("fast")
    for changed in ({"weights": network.weights[1:]}, {"correction": network.correction[:, 1:]}):
        calibration_file.save(path, replace(calibrated(), fitted={"fast": replace(network, **changed)}))
        assert calibrations.load(path).fitted == {}
    calibration_file.save(path, replace(calibrated(), fitted={"other": network}))
    assert calibrations.load(path).fitted == {}


@pytest.mark.parametrize(
    ("settings", "source"), [(V4l2(), V4l2Source), (Files(path="a"), FilesSource), (Simulated(), SimulatedSource)]
)
def test_each_kind_of_source_is_made_from_its_settings(settings: Source, source: type) -> None:
    assert isinstance(make_source(settings), source)


def test_every_kind_in_the_settings_has_a_source() -> None:
    assert set(SOURCES) == set(Source.__args__)
    assert isinstance(Settings().source, V4l2)


def test_a_camera_needs_no_simulator(tmp_path: Path) -> None:
    code = (
        "import sys; from tacshade_edge.factories.sources import make_source; from tacshade_edge.settings import V4l2;"
        "make_source(V4l2()); print([m for m in sys.modules if 'simulat' in m])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout.strip() == "[]"
