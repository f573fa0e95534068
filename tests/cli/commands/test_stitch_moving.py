"""`stitch --find-flange` of a recording in which the robot moves in contact, its clock behind that of the frames."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.calibrated_sensor import calibrated, simulated
from support.progress_lines import without_progress

from tacshade_edge.cli import main
from tacshade_edge.simulator.press import Press
from tacshade_edge.types import U8
from tools.studies.flange import DELAY_S, TRUE, write_recording
from tools.testbed.flange_plan import TURNS_DEG, Turns

pytestmark = pytest.mark.slow


def find_flange(tmp_path: Path, presses: int, turns: Turns) -> int:
    def picture(pressed: tuple[Press, ...], seed: int) -> U8:
        return simulated().frame(pressed, seed).image

    write_recording(tmp_path / "recording", picture, calibrated(), presses, turns, (0.1, 0.1))
    words = ["stitch", "--find-flange", "--calibration", str(tmp_path / "recording" / "cal.npz"), "--profile", "fast"]
    return main([*words, "--recording", str(tmp_path / "recording"), "--out", str(tmp_path / "out")])


def test_it_finds_the_place_and_the_delay(tmp_path: Path) -> None:
    assert find_flange(tmp_path, 50, TURNS_DEG) == 0
    about = json.loads((tmp_path / "out" / "flange.json").read_text())
    assert about["presses"] == 50
    assert about["delay_ms"] == pytest.approx(1000 * DELAY_S, abs=5)
    # The fast profile, half the pixels, and half of the plan, from 10 mm off.
    assert np.linalg.norm(np.subtract(about["flange_T_sensor"][:3], TRUE.translation_mm)) < 2.0


def test_motion_in_one_orientation_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert find_flange(tmp_path, 15, (((0, 0, 0),) * 5,)) == 78
    (line,) = without_progress(capsys.readouterr().err)
    assert "translation along x, y and z cannot be determined: every press has the same orientation" in line
    assert not (tmp_path / "out").exists()
