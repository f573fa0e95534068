"""A touchpad of one bar, and a simulated camera that a hand presses."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest
import yaml

from tacshade_edge.cli.commands import simulate
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.pad import Bar, Pad
from tacshade_edge.studies.parallel import ThisProcess


@pytest.fixture(scope="module")
def small_pad() -> Iterator[None]:
    """A touchpad of one bar, pressed in this process."""
    with pytest.MonkeyPatch.context() as patch:
        small = Pad(14.0, 10.0, (Bar(2.1, 5.1, 12.1, 5.1, 3.0),))
        patch.setattr("tacshade_edge.simulator.pad.touchpad", lambda: small)
        patch.setattr(simulate, "workers", lambda cluster: nullcontext(ThisProcess()))
        yield


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
