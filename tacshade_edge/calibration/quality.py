"""Grade a calibration in one line, with advice: do presses cover disc, depths and sizes,
and how well do they fit?
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode, finding
from tacshade_edge.calibration.observation import PressObservation
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.types import F64, Fit, Geometry

# docs/how-to/calibration.md advises at least this many.
_FEW_PRESSES = 16
# As part of the visible circle's radius: reach of the presses, their least RMS distance from their
# mean, and least reach on each side.
_REACH_RHO, _LEAST_RMS_RHO, _SIDE_RHO = 0.66, 0.35, 0.25
# As part of the skin's radius: depths and ball radii to advise,
# and the least depth of the deepest press.
_DEPTHS, _BALL_RADII, _LEAST_DEEPEST = (1 / 40, 1 / 5), (0.15, 0.45), 0.12
# Least ratio of the greatest to the smallest.
_DEPTH_RATIO, _BALL_RADIUS_RATIO = 2.0, 1.5
Grade = Literal["good", "fair", "poor", "uncalibrated"]

GRADED_PROFILE = "accurate"
"""The profile whose error grades a calibration."""
# On the nominal skin: mean depth error, and how well the presses agree with each other.
# `tools/studies/calibration.py` measures both for good presses and for presses stated 0.3 and 0.6
# mm off (table in calibration-checks.md).
_DEPTH_GOOD_MM, _DEPTH_FAIR_MM = 0.30, 0.50
_AGREEMENT_GOOD_MM, AGREEMENT_FAIR_MM = 0.25, 0.45
_TO_REPEAT = 3


def missing_coverage(
    presses: Sequence[PressObservation], geometry: Geometry
) -> tuple[CalibrationFinding, ...]:
    """Each gap in the presses."""
    places = np.array([press.place_mm for press in presses])
    depths = np.array([press.depth_mm for press in presses])
    few = len(presses) < _FEW_PRESSES
    gaps = (
        finding(FindingCode.MORE_PRESSES, found=len(presses)) if few else None,
        _missing_places(places, geometry),
        _missing_depths(float(depths.min()), float(depths.max()), geometry),
        _missing_sizes(presses, geometry),
    )
    return tuple(gap for gap in gaps if gap)


def _missing_places(places: F64, geometry: Geometry) -> CalibrationFinding | None:
    visible_mm = geometry.visible_radius_mm
    middle = places.mean(axis=0)
    rms_mm = math.sqrt(float(((places - middle) ** 2).sum(axis=1).mean()))
    reach_mm = _REACH_RHO * visible_mm
    if rms_mm < _LEAST_RMS_RHO * visible_mm:
        x_mm, y_mm = (round(float(v)) for v in middle)
        return finding(FindingCode.CLOSE_TOGETHER, x_mm=x_mm, y_mm=y_mm, reach_mm=reach_mm)
    low, high = places.min(axis=0), places.max(axis=0)
    # By the axes, because a person sets a stage along them.
    extremes = {"x < 0": -low[0], "x > 0": high[0], "y < 0": -low[1], "y > 0": high[1]}
    sides = [side for side, most_mm in extremes.items() if most_mm < _SIDE_RHO * visible_mm]
    return finding(FindingCode.EMPTY_SIDES, sides=sides, reach_mm=reach_mm) if sides else None


def _missing_depths(low_mm: float, high_mm: float, geometry: Geometry) -> CalibrationFinding | None:
    shallow_mm, deep_mm = (part * geometry.size_mm for part in _DEPTHS)
    if high_mm < _DEPTH_RATIO * low_mm:
        return finding(
            FindingCode.SAME_DEPTHS,
            low_mm=low_mm,
            high_mm=high_mm,
            shallow_mm=shallow_mm,
            deep_mm=deep_mm,
        )
    if high_mm < _LEAST_DEEPEST * geometry.size_mm:
        return finding(FindingCode.SHALLOW, deepest_mm=high_mm, deep_mm=deep_mm)
    return None


def _missing_sizes(
    presses: Sequence[PressObservation], geometry: Geometry
) -> CalibrationFinding | None:
    indenters = {press.indenter for press in presses}
    radii = [press.radius_mm for press in presses if not press.indenter]
    if len(indenters) > 1 or (radii and max(radii) >= _BALL_RADIUS_RATIO * min(radii)):
        return None
    low_mm, high_mm = (part * geometry.size_mm for part in _BALL_RADII)
    used = (min(radii), max(radii)) if radii else indenters.pop()
    return finding(FindingCode.SAME_INDENTER, used=used, low_mm=low_mm, high_mm=high_mm)


@dataclass(frozen=True, slots=True)
class Quality:
    """A grade, the line that explains it, and advice,
    most useful first (empty if the grade is good).
    """

    grade: Grade
    line: CalibrationFinding
    advice: tuple[CalibrationFinding, ...]


UNCALIBRATED = Quality(
    "uncalibrated",
    finding(FindingCode.UNCALIBRATED),
    (finding(FindingCode.NO_PRESSES),),
)
"""The quality of a calibration without presses."""


def assess(
    fit: Fit,
    geometry: Geometry,
    missing: Sequence[CalibrationFinding],
    errors_mm: Sequence[tuple[str, float]],
) -> Quality:
    """Grade a fit to presses, given what they do not cover,
    and the depth error of each in the graded profile.
    """
    if GRADED_PROFILE not in fit.profiles:
        return Quality(
            "poor",
            finding(FindingCode.CONTACTS_NOT_FOUND),
            (finding(FindingCode.LOOK_AT_PRESSES),),
        )
    profile, scale = fit.profiles[GRADED_PROFILE], skin_scale(geometry)
    depth, agreement = profile.depth_mae_mm / scale, fit.agreement_mae_mm / scale
    is_good = depth <= _DEPTH_GOOD_MM and agreement <= _AGREEMENT_GOOD_MM and not missing
    is_fair = depth <= _DEPTH_FAIR_MM and agreement <= AGREEMENT_FAIR_MM
    grade: Grade = "poor" if not is_fair else "good" if is_good else "fair"
    line = finding(
        FindingCode.DEPTH_WITHIN,
        grade=grade,
        mean_mm=_rounded_up(profile.depth_mae_mm),
        worst_mm=_rounded_up(profile.depth_worst_mm),
        profile=GRADED_PROFILE,
    )
    advice = list(missing)
    if agreement > _AGREEMENT_GOOD_MM:
        advice.append(finding(FindingCode.DISAGREEING, mean_mm=_rounded_up(fit.agreement_mae_mm)))
    if depth > _DEPTH_GOOD_MM:
        worst = sorted(errors_mm, key=lambda press: -abs(press[1]))[:_TO_REPEAT]
        advice.append(finding(FindingCode.REPEAT, worst=worst))
    return Quality(grade, line, tuple(advice))


def _rounded_up(value_mm: float) -> float:
    """Round up to 0.05 mm, because the sentence says "within"."""
    return math.ceil(value_mm / 0.05 - 1e-9) * 0.05
