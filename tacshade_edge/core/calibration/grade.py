"""How good a calibration is, in a line, and what to do when it is not good."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from tacshade_edge.types import Geometry

Grade = Literal["good", "fair", "poor", "uncalibrated"]

# Cross-validated mean depth error of `accurate` on a skin of 20 mm, and how well the presses agree with each other when
# ball and place are known. docs/calibration.md has what good presses give, and presses stated 0.3 and 0.6 mm off.
_DEPTH_GOOD_MM, _DEPTH_FAIR_MM = 0.30, 0.50
_AGREE_GOOD_MM, _AGREE_FAIR_MM = 0.25, 0.45
_REPEAT = 3


@dataclass(frozen=True, slots=True)
class Verdict:
    """How good, one line, and what to do, most useful first (empty when good)."""

    grade: Grade
    line: str
    advice: tuple[str, ...]


def judge(
    fit: Mapping[str, float], geometry: Geometry, missing: Sequence[str], worst: Sequence[tuple[str, float]]
) -> Verdict:
    """Judge a fit.

    Parameters
    ----------
    fit : mapping of str to float
        `Calibration.fit` with `accurate_depth_mae_mm`, `accurate_depth_worst_mm` and `agreement_mae_mm`; empty
        without presses.
    geometry : Geometry
    missing : sequence of str
        What `press_checks.coverage` misses.
    worst : sequence of (name, error in mm)
        The presses, the worst first.
    """
    if fit and "accurate_depth_mae_mm" not in fit:
        return Verdict(
            "poor",
            "poor: the learned profiles see a contact where the ball is in fewer presses than a fit needs",
            ("look at the presses' images, places and depths, and at SENSOR.yaml",),
        )
    if not fit:
        return Verdict(
            "uncalibrated",
            "depth is what sensors of this kind give on average: no --presses to measure how good that is for this one",
            ("take 20 to 40 ball presses and pass --presses PRESSES.csv (docs/calibration.md)",),
        )
    scale = geometry.skin_radius_mm / 20
    depth, agree = fit["accurate_depth_mae_mm"] / scale, fit["agreement_mae_mm"] / scale
    grade: Grade = "good"
    if depth > _DEPTH_GOOD_MM or agree > _AGREE_GOOD_MM or missing:
        grade = "fair"
    if depth > _DEPTH_FAIR_MM or agree > _AGREE_FAIR_MM:
        grade = "poor"
    line = (
        f"{grade}: ball depth within {_up(fit['accurate_depth_mae_mm'])} mm of what was stated on average, "
        f"{_up(fit['accurate_depth_worst_mm'])} mm at worst, on presses it had not seen"
    )
    advice = list(missing)
    if agree > _AGREE_GOOD_MM:
        advice.append(
            f"the presses agree with each other only within {_up(fit['agreement_mae_mm'])} mm: "
            "measure their depths and places more exactly"
        )
    if depth > _DEPTH_GOOD_MM:
        names = ", ".join(f"{name} ({error:.1f} mm off)" for name, error in worst[:_REPEAT])
        advice.append(f"repeat these presses, or more like them: {names}")
    return Verdict(grade, line, tuple(advice))


def _up(value_mm: float) -> str:
    """Rounded up to 0.05 mm: "within" must not be too little."""
    return f"{math.ceil(value_mm / 0.05 - 1e-9) * 0.05:.2f}"
