from __future__ import annotations

import pytest

from tacshade_edge.core.calibration.grade import judge
from tacshade_edge.types import Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))
GOOD = {"accurate_depth_mae_mm": 0.201, "accurate_depth_worst_mm": 0.7, "agreement_mae_mm": 0.1}
WORST = (("press 3", 0.7), ("press 1", 0.5), ("press 2", 0.4), ("press 9", 0.1))


def test_a_good_one_needs_nothing() -> None:
    verdict = judge(GOOD, GEOMETRY, (), WORST)
    assert verdict.grade == "good"
    assert verdict.line == (
        "good: ball depth within 0.25 mm of what was stated on average, 0.70 mm at worst, on presses it had not seen"
    )
    assert verdict.advice == ()


@pytest.mark.parametrize(
    ("figures", "grade", "advice"),
    [
        (
            {"accurate_depth_mae_mm": 0.5},
            "fair",
            "repeat these presses, or more like them: press 3 (0.7 mm off), press 1",
        ),
        ({"accurate_depth_mae_mm": 0.9}, "poor", "repeat these presses"),
        ({"agreement_mae_mm": 0.3}, "fair", "the presses agree with each other only within 0.30 mm"),
        ({"agreement_mae_mm": 0.5}, "poor", "measure their depths and places more exactly"),
    ],
)
def test_what_is_not_good_says_what_to_do(figures: dict[str, float], grade: str, advice: str) -> None:
    verdict = judge(GOOD | figures, GEOMETRY, (), WORST)
    assert verdict.grade == grade
    assert verdict.line.startswith(f"{grade}: ")
    (only,) = verdict.advice
    assert advice in only
    assert "press 9" not in only


def test_what_is_missing_comes_first() -> None:
    verdict = judge(GOOD | {"accurate_depth_mae_mm": 0.4}, GEOMETRY, ("no press lies at x < 0",), WORST)
    assert verdict.grade == "fair"
    assert verdict.advice[0] == "no press lies at x < 0"
    assert len(verdict.advice) == 2


def test_lengths_scale_with_the_skin() -> None:
    figures = GOOD | {"accurate_depth_mae_mm": 0.4}
    assert judge(figures, GEOMETRY, (), WORST).grade == "fair"
    assert judge(figures, Geometry(28.0, 14.0, 50.0, Disc(100, 100, 80)), (), WORST).grade == "good"


def test_without_presses() -> None:
    verdict = judge({}, GEOMETRY, (), ())
    assert verdict.grade == "uncalibrated"
    assert "--presses PRESSES.csv" in verdict.advice[0]


def test_presses_in_which_the_networks_saw_nothing_are_not_called_missing() -> None:
    verdict = judge({"presses": 9.0, "agreement_mae_mm": 0.1}, GEOMETRY, (), ())
    assert verdict.grade == "poor"
    assert "SENSOR.yaml" in verdict.advice[0]
