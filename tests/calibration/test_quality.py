from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from tacshade_edge.calibration.findings import FindingCode, finding
from tacshade_edge.calibration.observation import PressObservation
from tacshade_edge.calibration.quality import assess, missing_coverage
from tacshade_edge.calibration.sentences import sentence
from tacshade_edge.lab.simulator.script import ball_presses
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.types import Disc, Fit, Geometry, ProfileFit

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))
ERRORS_MM = (("press 9", 0.1), ("press 3", -0.7), ("press 1", 0.5), ("press 2", 0.4))
VISIBLE_MM = 20 * math.sin(math.radians(50))
PRESSES = [
    PressObservation(
        f"press {k}", 5.0, 5.0, 20.0, p.x_mm, p.y_mm, radius_mm, p.depth_mm, p.x_mm, p.y_mm
    )
    for k, (p, radius_mm) in enumerate(ball_presses(SensorModel(), 24))
]


def fit(depth_mae_mm: float = 0.201, agreement_mae_mm: float = 0.1) -> Fit:
    return Fit(20, agreement_mae_mm, 0.5, {"accurate": ProfileFit(20, depth_mae_mm, 0.7)})


def test_a_good_one_needs_nothing() -> None:
    quality = assess(fit(), GEOMETRY, (), ERRORS_MM)
    assert (quality.grade, quality.advice) == ("good", ())
    assert sentence(quality.line).startswith(
        "good: depth is within 0.25 mm of the stated depth on average, 0.70 mm at worst, "
    )


@pytest.mark.parametrize(
    ("found", "grade", "advice"),
    [
        (
            fit(depth_mae_mm=0.5),
            "fair",
            "repeat these presses, or more like them: press 3 (-0.7 mm off), press 1",
        ),
        (fit(depth_mae_mm=0.9), "poor", "repeat these presses"),
        (
            fit(agreement_mae_mm=0.3),
            "fair",
            "the presses agree with each other only within 0.30 mm",
        ),
        (fit(agreement_mae_mm=0.5), "poor", "measure their depths and places more exactly"),
    ],
)
def test_what_is_not_good_has_an_advice(found: Fit, grade: str, advice: str) -> None:
    quality = assess(found, GEOMETRY, (), ERRORS_MM)
    assert quality.grade == grade
    assert sentence(quality.line).startswith(f"{grade}: ")
    (only,) = quality.advice
    assert advice in sentence(only)
    assert "press 9" not in sentence(only)


def test_what_is_missing_comes_first() -> None:
    gap = finding(FindingCode.MORE_PRESSES, found=9)
    quality = assess(fit(depth_mae_mm=0.4), GEOMETRY, (gap,), ERRORS_MM)
    assert quality.grade == "fair"
    assert quality.advice[0] == gap
    assert len(quality.advice) == 2


@pytest.mark.parametrize("radius_mm", [12.0, 30.0])
def test_lengths_scale_with_the_skin(radius_mm: float) -> None:
    geometry = replace(GEOMETRY, skin_radius_mm=radius_mm)
    for depth_mm, agreement_mm, grade in (
        (0.29, 0.24, "good"),
        (0.31, 0.1, "fair"),
        (0.2, 0.26, "fair"),
    ):
        scaled = fit(depth_mm * radius_mm / 20, agreement_mm * radius_mm / 20)
        assert assess(scaled, geometry, (), ERRORS_MM).grade == grade


def test_presses_in_which_the_networks_saw_nothing_are_not_called_missing() -> None:
    quality = assess(Fit(9, 0.1, 0.5), GEOMETRY, (), ())
    assert quality.grade == "poor"
    assert "SENSOR.yaml" in sentence(quality.advice[0])


def missing(presses: list[PressObservation]) -> str:
    return "\n".join(map(sentence, missing_coverage(presses, GEOMETRY)))


def test_presses_spread_over_everything_miss_nothing() -> None:
    assert missing(PRESSES) == ""
    assert missing([replace(o, x_mm=None, y_mm=None) for o in PRESSES]) == ""


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (
            lambda k, o: replace(o, x_mm=o.x_mm / 5, y_mm=o.y_mm / 5),
            "the presses lie close together, around x 0, y 0 mm",
        ),
        (
            lambda k, o: replace(o, x_mm=abs(o.x_mm)),
            "no press lies at x < 0: add some up to 10 mm from the middle",
        ),
        (lambda k, o: replace(o, y_mm=-abs(o.y_mm)), "no press lies at y > 0: "),
        (
            lambda k, o: replace(o, depth_mm=1 + k / 46),
            "all presses are 1.0 to 1.5 mm deep: add some from 0.5 to 4.0 mm",
        ),
        (lambda k, o: replace(o, depth_mm=o.depth_mm / 2), "no press is deeper than 1.9 mm"),
        (
            lambda k, o: replace(o, radius_mm=5 + k % 2),
            "all presses use balls of radius 5 to 6 mm: ",
        ),
        (lambda k, o: replace(o, indenter="cone"), "all presses use cone: "),
    ],
)
def test_a_gap_is_named(
    change: Callable[[int, PressObservation], PressObservation], wanted: str
) -> None:
    (found,) = missing_coverage([change(k, o) for k, o in enumerate(PRESSES)], GEOMETRY)
    assert sentence(found).startswith(wanted)
    assert "12 presses: 20 to 40" in missing(PRESSES[::2])
