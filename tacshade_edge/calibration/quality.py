"""Grade a calibration in one line, with advice: do presses cover disc, depths and sizes,
and how well do they fit?
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

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


def missing_coverage(presses: Sequence[PressObservation], geometry: Geometry) -> tuple[str, ...]:
    """A line of advice for each gap in the presses."""
    places = np.array([press.place_mm for press in presses])
    depths = np.array([press.depth_mm for press in presses])
    few = len(presses) < _FEW_PRESSES
    lines = (
        f"{len(presses)} presses: 20 to 40 make the depth and its error more certain"
        if few
        else "",
        _missing_places(places, geometry),
        _missing_depths(float(depths.min()), float(depths.max()), geometry),
        _missing_sizes(presses, geometry),
    )
    return tuple(line for line in lines if line)


def _missing_places(places: F64, geometry: Geometry) -> str:
    visible_mm = geometry.visible_radius_mm
    middle = places.mean(axis=0)
    rms_mm = math.sqrt(float(((places - middle) ** 2).sum(axis=1).mean()))
    reach = f"up to {_REACH_RHO * visible_mm:.0f} mm from the middle"
    if rms_mm < _LEAST_RMS_RHO * visible_mm:
        x_mm, y_mm = (round(float(v)) for v in middle)
        return f"the presses lie close together, around x {x_mm}, y {y_mm} mm: add some {reach}"
    low, high = places.min(axis=0), places.max(axis=0)
    extremes = {"x < 0": -low[0], "x > 0": high[0], "y < 0": -low[1], "y > 0": high[1]}
    sides = " or ".join(
        side for side, most_mm in extremes.items() if most_mm < _SIDE_RHO * visible_mm
    )
    return f"no press lies at {sides}: add some {reach}" if sides else ""


def _missing_depths(low_mm: float, high_mm: float, geometry: Geometry) -> str:
    shallow_mm, deep_mm = (part * geometry.size_mm for part in _DEPTHS)
    if high_mm < _DEPTH_RATIO * low_mm:
        wanted = f"{shallow_mm:.1f} to {deep_mm:.1f} mm"
        return f"all presses are {low_mm:.1f} to {high_mm:.1f} mm deep: add some from {wanted}"
    if high_mm < _LEAST_DEEPEST * geometry.size_mm:
        return f"no press is deeper than {high_mm:.1f} mm: add some down to {deep_mm:.1f} mm"
    return ""


def _missing_sizes(presses: Sequence[PressObservation], geometry: Geometry) -> str:
    indenters = {press.indenter for press in presses}
    radii = [press.radius_mm for press in presses if not press.indenter]
    if len(indenters) > 1 or (radii and max(radii) >= _BALL_RADIUS_RATIO * min(radii)):
        return ""
    low_mm, high_mm = (part * geometry.size_mm for part in _BALL_RADII)
    used = indenters.pop()
    if radii:
        used = (
            "balls of radius "
            f"{min(radii):g}{f' to {max(radii):g}' if max(radii) > min(radii) else ''} mm"
        )
    wanted = f"balls of {low_mm:.0f} to {high_mm:.0f} mm"
    return f"all presses use {used}: other sizes and shapes are less certain; add {wanted}"


@dataclass(frozen=True, slots=True)
class Quality:
    """A grade, the line that explains it, and advice,
    most useful first (empty if the grade is good).
    """

    grade: Grade
    line: str
    advice: tuple[str, ...]


UNCALIBRATED = Quality(
    "uncalibrated",
    (
        "uncalibrated: depth assumes an average sensor of this kind; only --presses can measure "
        "its error on this one"
    ),
    ("take 20 to 40 presses and pass --presses PRESSES.csv (docs/how-to/calibration.md)",),
)
"""The quality of a calibration without presses."""


def assess(
    fit: Fit, geometry: Geometry, missing: Sequence[str], errors_mm: Sequence[tuple[str, float]]
) -> Quality:
    """Grade a fit to presses, given what they do not cover,
    and the depth error of each in the graded profile.
    """
    if GRADED_PROFILE not in fit.profiles:
        return Quality(
            "poor",
            (
                "poor: the learned profiles find the contact at the indenter in too few presses "
                "for a fit"
            ),
            ("look at the presses' images, places and depths, and at SENSOR.yaml",),
        )
    profile, scale = fit.profiles[GRADED_PROFILE], skin_scale(geometry)
    depth, agreement = profile.depth_mae_mm / scale, fit.agreement_mae_mm / scale
    is_good = depth <= _DEPTH_GOOD_MM and agreement <= _AGREEMENT_GOOD_MM and not missing
    is_fair = depth <= _DEPTH_FAIR_MM and agreement <= AGREEMENT_FAIR_MM
    grade: Grade = "poor" if not is_fair else "good" if is_good else "fair"
    line = (
        f"{grade}: depth is within {_rounded_up(profile.depth_mae_mm)} mm of the stated depth on "
        f"average, {_rounded_up(profile.depth_worst_mm)} mm at worst, on held-out presses (profile "
        f"{GRADED_PROFILE})"
    )
    advice = list(missing)
    if agreement > _AGREEMENT_GOOD_MM:
        advice.append(
            f"the presses agree with each other only within {_rounded_up(fit.agreement_mae_mm)} "
            "mm: measure their depths and places more exactly"
        )
    if depth > _DEPTH_GOOD_MM:
        worst = sorted(errors_mm, key=lambda press: -abs(press[1]))[:_TO_REPEAT]
        names = ", ".join(f"{name} ({error:.1f} mm off)" for name, error in worst)
        advice.append(f"repeat these presses, or more like them: {names}")
    return Quality(grade, line, tuple(advice))


def _rounded_up(value_mm: float) -> str:
    """Round up to 0.05 mm, because the message says "within"."""
    return f"{math.ceil(value_mm / 0.05 - 1e-9) * 0.05:.2f}"
