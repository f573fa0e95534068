"""Grade a calibration in one line, with advice if it is not good."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.types import Fit, Geometry

Grade = Literal["good", "fair", "poor", "uncalibrated"]

GRADED_PROFILE = "accurate"
"""The profile whose error grades a calibration."""
# On the nominal skin: mean depth error, and how well the presses agree with each other. `tools/studies/calibration.py`
# measures both for good presses and for presses stated 0.3 and 0.6 mm off (table in calibration-checks.md).
_DEPTH_GOOD_MM, _DEPTH_FAIR_MM = 0.30, 0.50
_AGREEMENT_GOOD_MM, AGREEMENT_FAIR_MM = 0.25, 0.45
_TO_REPEAT = 3


@dataclass(frozen=True, slots=True)
class Quality:
    """A grade, the line that explains it, and advice, most useful first (empty if the grade is good)."""

    grade: Grade
    line: str
    advice: tuple[str, ...]


UNCALIBRATED = Quality(
    "uncalibrated",
    "uncalibrated: depth assumes an average sensor of this kind; only --presses can measure its error on this one",
    ("take 20 to 40 presses and pass --presses PRESSES.csv (docs/how-to/calibration.md)",),
)
"""The quality of a calibration without presses."""


def assess(fit: Fit, geometry: Geometry, missing: Sequence[str], errors_mm: Sequence[tuple[str, float]]) -> Quality:
    """Grade a fit to presses, given advice on what they do not cover, and the depth error of each in the graded
    profile.
    """
    if GRADED_PROFILE not in fit.profiles:
        return Quality(
            "poor",
            "poor: the learned profiles find the contact at the indenter in too few presses for a fit",
            ("look at the presses' images, places and depths, and at SENSOR.yaml",),
        )
    profile, scale = fit.profiles[GRADED_PROFILE], skin_scale(geometry)
    depth, agreement = profile.depth_mae_mm / scale, fit.agreement_mae_mm / scale
    grade: Grade = "good"
    if depth > _DEPTH_GOOD_MM or agreement > _AGREEMENT_GOOD_MM or missing:
        grade = "fair"
    if depth > _DEPTH_FAIR_MM or agreement > AGREEMENT_FAIR_MM:
        grade = "poor"
    line = (
        f"{grade}: depth is within {_rounded_up(profile.depth_mae_mm)} mm of the stated depth on average, "
        f"{_rounded_up(profile.depth_worst_mm)} mm at worst, on held-out presses (profile {GRADED_PROFILE})"
    )
    advice = list(missing)
    if agreement > _AGREEMENT_GOOD_MM:
        advice.append(
            f"the presses agree with each other only within {_rounded_up(fit.agreement_mae_mm)} mm: "
            "measure their depths and places more exactly"
        )
    if depth > _DEPTH_GOOD_MM:
        worst = sorted(errors_mm, key=lambda press: -abs(press[1]))[:_TO_REPEAT]
        names = ", ".join(f"{name} ({error:.1f} mm off)" for name, error in worst)
        advice.append(f"repeat these presses, or more like them: {names}")
    return Quality(grade, line, tuple(advice))


def _rounded_up(value_mm: float) -> str:
    """Round up to 0.05 mm, because the message says "within"."""
    return f"{math.ceil(value_mm / 0.05 - 1e-9) * 0.05:.2f}"
