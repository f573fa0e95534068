"""The study of held objects: what its grasps are, and what it says of a tracker."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tools.studies.object_motion import __main__ as program
from tools.studies.object_motion.grasps import FARTHEST_MM, SKINS, Plan, Skin, trials
from tools.studies.object_motion.score import score

EXACT = Skin(*[0.0] * 7, frame_shear_mm=0.0, frame_depth_mm=0.0, frame_deg=0.0, slow_mm=0.0, slow_deg=0.0)


@pytest.mark.parametrize("event", ["moves", "a finger leaves", "a finger joins"])
@pytest.mark.parametrize("fingers", [2, 5])
def test_without_errors_the_motion_is_found(event: str, fingers: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SKINS, "exact", EXACT)
    for trial in trials(Plan(1, (fingers,), skins=("exact",), events=(event,), rest_s=0.1)):
        row = score(trial)
        assert row.patch_mm < FARTHEST_MM + 1e-6
        assert row.named
        assert row.jump_mm < 0.2
        if not row.hidden:
            assert row.translation_off_mm < 0.05, trial.object
            assert row.rotation_off_deg < 0.5, trial.object


@pytest.mark.slow
def test_errors_are_drawn_as_stated() -> None:
    drawn = [t for t in trials(Plan(5, (5,), ("ball",), ("tacshade",), ("moves",), 0.1)) if t.event == "moves"]
    gains = []
    for trial in drawn:
        first, *_, last = trial.moments
        for i, key in enumerate(first.patches):
            axis = np.array(last.patches[key].axis)
            way = last.moved.apply(trial.points_mm[1 + i]) - trial.points_mm[1 + i]
            way -= axis * (axis @ way)
            found = np.subtract(last.patches[key].shear_mm, first.patches[key].shear_mm)
            if np.linalg.norm(way) > 0.5:
                gains.append(found @ way / (way @ way) - 1)
    assert np.mean(gains) == pytest.approx(SKINS["tacshade"].gain_mean, abs=0.08)
    assert 0.05 < np.std(gains) < 0.25


def test_equal_plans_give_equal_rows() -> None:
    plan = Plan(1, (3,), ("box",), ("other",), ("a finger slips",), 0.1)
    once, again = ([replace(score(trial), step_ms=0.0) for trial in trials(plan)] for _ in range(2))
    assert once == again


def test_it_writes_a_table_and_its_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    small = partial(Plan, fingers=(2,), objects=("ball",), skins=("tacshade",), events=("moves",))
    monkeypatch.setattr(program, "Plan", small)
    program.main(["--trials", "1", "--rest-s", "2", "--csv", str(tmp_path / "rows.csv")])
    assert capsys.readouterr().out.count("| all") == 3
    assert (tmp_path / "rows.csv").read_text().count("\n") == 4
