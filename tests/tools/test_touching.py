"""The study of objects that touch each other: its scenes, its table and its rows."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from support.calibrated_sensor import HALF
from support.half_family import half_family
from tacshade_edge.lab.simulator.press import Press, distances_mm
from tools.studies import touching


@pytest.mark.parametrize("scene", touching.PAIRS)
@pytest.mark.parametrize("gap_mm", [0.0, 0.5])
def test_two_objects_stand_on_one_level_with_the_gap_between_their_surfaces(
    scene: str, gap_mm: float
) -> None:
    parts = touching.PAIRS[scene]()
    middle = Press(parts[0].shape, 1.0, -2.0, 3.0, 30.0, drag_x_mm=1.0)
    pair = touching.pair_presses(HALF, parts, gap_mm, middle)
    levels = [each.lowest_z_mm(HALF.skin_radius_mm) for each in pair]
    assert levels == pytest.approx([middle.lowest_z_mm(HALF.skin_radius_mm)] * 2)
    assert {(each.drag_x_mm, each.rotation_deg) for each in pair} == {(1.0, 30.0)}
    # Along the line through both, at the height where the surfaces are nearest.
    turn, away = math.radians(30.0), np.linspace(-2, 2, 401)
    nearest = []
    for up_mm in np.linspace(0, 12, 241):
        z = np.full(401, levels[0] + up_mm)
        line = np.stack((1.0 + away * math.cos(turn), -2.0 + away * math.sin(turn), z), axis=1)
        apart = distances_mm(pair, HALF.skin_radius_mm, line)
        nearest.append(float(np.min(np.maximum(apart, 0).sum(axis=0))))
    assert min(nearest) == pytest.approx(gap_mm, abs=0.02)


@pytest.mark.slow
def test_the_study_counts_what_is_found_of_two_and_of_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(touching, "PAIR_PLACES", 1)
    monkeypatch.setattr(touching, "SINGLE_PLACES", 1)
    words = ["--scenes", "two balls", "L", "--profile", "fast", "--references", "1"]
    with half_family():
        touching.main(
            ["--sensors", "half:default", *words, "--presses", "8", "--out", str(tmp_path)]
        )
    assert capsys.readouterr().out == (tmp_path / "touching.md").read_text(encoding="utf-8")
    with (tmp_path / "touching.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["true_objects"] for row in rows if row["scene"] == "two balls"} == {"2"}
    assert [row["objects"] for row in rows if row["scene"] == "L"] == ["1", "1"]
    assert any(row["objects"] == "2" for row in rows if row["gap_mm"] == "1")
