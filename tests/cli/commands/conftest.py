"""A touchpad of one bar, and a simulated camera that a hand presses."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import cv2
import pytest
import yaml

from support.calibrated_sensor import HALF, calibrated, pressed, unloaded
from support.sensor_files import write_files
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli.commands import simulate
from tacshade_edge.lab.parallel import ThisProcess
from tacshade_edge.lab.simulator.pad import Bar, Pad
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.types import RestLimits


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Words of `calibrate`: SENSOR.yaml, presses and references."""
    return write_files(tmp_path_factory.mktemp("sensor"))


@pytest.fixture(scope="module")
def alone(words: list[str]) -> list[str]:
    """SENSOR.yaml and references, without presses."""
    return [*words[:2], *words[4:]]


@pytest.fixture(scope="module")
def small_pad() -> Iterator[None]:
    """A touchpad of one bar, pressed in this process."""
    with pytest.MonkeyPatch.context() as patch:
        small = Pad(14.0, 10.0, (Bar(2.1, 5.1, 12.1, 5.1, 3.0),))
        patch.setattr("tacshade_edge.lab.simulator.pad.touchpad", lambda: small)
        patch.setattr(simulate, "workers", lambda cluster: nullcontext(ThisProcess()))
        yield


@pytest.fixture
def faint(tmp_path: Path) -> tuple[Path, Path]:
    """A calibration that knows the sensor at rest,
    and a folder with a free picture and a touch that no map shows.
    """
    limits = RestLimits(60, 1e-4, height_mm=0.001, local_change=0.9, changed_part=0.9)
    calibration, pictures = tmp_path / "rest.npz", tmp_path / "pictures"
    known = replace(calibrated(HALF, 0), rest=dict.fromkeys(("fast", "balanced"), limits))
    calibration_file.save(calibration, known)
    pictures.mkdir()
    for k, image in enumerate((unloaded(), pressed("ball", 0.1, HALF, 2.0).image)):
        cv2.imwrite(str(pictures / f"{k}.png"), image)
    return calibration, pictures


@pytest.fixture
def sensor_yaml() -> str:
    """The text of the simulated sensor's SENSOR.yaml."""
    model = SensorModel()
    keys = {
        name: getattr(model, name)
        for name in ("skin_radius_mm", "visible_half_angle_deg", "camera_distance_mm")
    }
    return str(yaml.safe_dump(keys | {"polarity": "bright"}))


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """Settings whose camera is simulated and shows what `press` presses."""
    path = tmp_path / "sim.yaml"
    path.write_text("source: {kind: simulated, fps: 20, pressed: hand.csv}\n")
    return path


@pytest.fixture
def press(tmp_path: Path) -> Callable[..., None]:
    """Presses what a row says, or lifts."""

    def pressed(row: str = "") -> None:
        beside = tmp_path / "hand.part"
        beside.write_text(f"indenter,radius_mm,depth_mm,x_mm,y_mm\n{row}\n")
        os.replace(beside, tmp_path / "hand.csv")

    pressed()
    return pressed
