from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.cli.shared import find_flange
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid, shift, turn
from tools.testbed.bumpy_surface import APEX_MM
from tools.testbed.flange_plan import exact_frames

TRUE = shift(12, -7, 55) @ turn((0.3, -0.2, 1.1))
START = shift(6, 6, -5) @ TRUE
ONE = (((0, 0, 0),) * 5,)


def run(tmp_path: Path, *, start: Rigid = START, as_json: bool = False, moving: bool = True) -> None:
    frames = exact_frames(TRUE, 20.0, moving=moving)
    find_flange.run(frames, start, APEX_MM, tmp_path, "POSES.csv", as_json=as_json)


def test_what_it_prints_goes_into_the_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(tmp_path)
    first, settings, delay = capsys.readouterr().out.splitlines()
    about = json.loads((tmp_path / "flange.json").read_text())
    assert about["flange_T_sensor"] == pytest.approx(TRUE.seven(), abs=0.3)
    assert first.startswith(f"{tmp_path / 'flange.json'}: 100 presses; 9.")
    assert settings.startswith("in SENSOR.yaml, then calibrate again: flange_T_sensor: [")
    line = settings.partition("[")[2].partition("]")[0]
    assert [float(value) for value in line.split(",")] == pytest.approx(about["flange_T_sensor"], rel=1e-5, abs=1e-5)
    assert delay.startswith("delay: frames are stamped ")
    assert about["delay_ms"] == pytest.approx(20, abs=5)


def test_without_motion_the_delay_is_null_and_the_line_names_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(tmp_path, moving=False)
    assert "delay: not found: no press moves while in contact" in capsys.readouterr().out
    assert json.loads((tmp_path / "flange.json").read_text())["delay_ms"] is None


def test_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(tmp_path, as_json=True)
    assert json.loads(capsys.readouterr().out) == json.loads((tmp_path / "flange.json").read_text())


@pytest.mark.slow
def test_one_orientation_is_refused(tmp_path: Path) -> None:
    frames = exact_frames(Rigid(np.eye(3), np.array((1.0, 2.0, 50.0))), 0.0, ONE, moving=False)
    with pytest.raises(
        ConfigError,
        match=r"^POSES.csv: translation along x, y and z cannot be determined: every press has the same orientation",
    ):
        find_flange.run(frames, shift(0, 0, 45), APEX_MM, tmp_path, "POSES.csv", as_json=False)
    assert not (tmp_path / "flange.json").exists()


def test_few_presses_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="found 2 presses with a pose, expected at least 12"):
        find_flange.run(exact_frames(TRUE, 0.0, moving=False)[:2], TRUE, APEX_MM, tmp_path, "R", as_json=False)


def test_a_start_that_is_far_off_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected at most 15 mm and 15 degrees"):
        run(tmp_path, start=shift(30, 0, 0) @ TRUE, moving=False)
