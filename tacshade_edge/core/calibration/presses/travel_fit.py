"""Predict the indenter's travel into the skin at each press from all the other presses.

A robust regression, sharper than a reconstruction because the indenter and its place are known: the travel from first
touch is a power law of what the image shows. (The depth of a press is that travel plus the depth at first touch.)
Iteration by P. W. Holland and R. E. Welsch (Comm. Stat. A 6, 1977) with P. J. Huber's weights (Ann. Math. Stat. 35,
1964), here 0 beyond `OUTLIER_DEVIATIONS`; A. E. Hoerl and R. W. Kennard's pull (Technometrics 12, 1970), here towards
usual weights; leave-one-out residuals from the leverage by D. M. Allen (Technometrics 16, 1974).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.observation.press_observation import PressObservation, first_touch_mm
from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.types import F64, Geometry, freeze

OUTLIER_DEVIATIONS = 4.0
"""A press is an outlier beyond this many standard deviations of all presses."""

# Regression of log(travel) on 1, log χ, ρ², ρ⁴, log ball radius, log brightened area, log brightening, and 1 for each
# other indenter, on the nominal skin: usual weights (0 for the indenters), which count where the presses leave a weight
# open, and the strength of the pull towards them.
_USUAL_WEIGHTS = np.array([0.0, 1.2, 0.0, 0.0, -0.3, 0.2, -0.25])
_RIDGE = 0.01
# Least standard deviation of log(travel), and of the travel in mm on the nominal skin.
_LEAST_DEVIATION, _LEAST_DEVIATION_MM = 0.06, 0.1
# Standard deviation of log(travel) that sets the weight of shallow presses.
_USUAL_DEVIATION = 0.1
_HUBER = 1.5
_LEAST_TRAVEL_MM = 0.05
_MAX_LEVERAGE = 0.9
_ITERATIONS = 12


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """The residual (N,) of each press from the fit without it: predicted less stated travel, and its size in robust
    standard deviations of all presses, less if the press dominates the fit.
    """

    error_mm: F64
    deviations: F64

    def __post_init__(self) -> None:
        freeze(self, "error_mm", "deviations")


def leave_one_out(observations: Sequence[PressObservation], geometry: Geometry) -> LeftOut:
    """Fit all presses robustly, and predict each from the others."""
    scale = skin_scale(geometry)
    features = _features(observations, geometry)
    depth_mm = np.array([o.depth_mm for o in observations])
    travel = np.maximum((depth_mm - first_touch_mm(observations, geometry)) / scale, _LEAST_TRAVEL_MM)
    log_travel, least = np.log(travel), _LEAST_DEVIATION_MM / travel
    # An error in mm is a larger ratio for a shallow press.
    trust = 1 / (1 + (least / _USUAL_DEVIATION) ** 2)
    weight = trust
    usual = np.concatenate((_USUAL_WEIGHTS, np.zeros(features.shape[1] - len(_USUAL_WEIGHTS))))
    pulled = np.diag([0.0] + [1.0] * (features.shape[1] - 1))
    for _ in range(_ITERATIONS):
        ridge = _RIDGE * float(weight.sum()) * pulled
        weighted = features * weight[:, None]
        normal = weighted.T @ features + ridge
        residual = log_travel - features @ np.linalg.solve(normal, weighted.T @ log_travel + ridge @ usual)
        deviation = np.hypot(max(1.4826 * float(np.median(np.abs(residual))), _LEAST_DEVIATION), least)
        z = np.abs(residual) / deviation
        kept = np.where(z < _HUBER, 1.0, _HUBER / np.maximum(z, _HUBER)) * (z < OUTLIER_DEVIATIONS)
        if not kept.any():
            break
        weight = trust * kept
    leverage = weight * np.einsum("ij,ij->i", features, np.linalg.solve(normal, features.T).T)
    rest = 1 - np.minimum(leverage, _MAX_LEVERAGE)
    without = residual / rest
    error = (np.exp(np.clip(-without, -5, 5)) - 1) * travel * scale
    return LeftOut(error, np.abs(without) * np.sqrt(rest) / deviation)


def agreement_mae_mm(observations: Sequence[PressObservation], geometry: Geometry) -> float:
    """Mean error of the depth of a press, predicted from all the others with indenter and place known; mm."""
    return float(np.mean(np.abs(leave_one_out(observations, geometry).error_mm)))


def _features(observations: Sequence[PressObservation], geometry: Geometry) -> F64:
    scale = skin_scale(geometry)
    visible_mm = geometry.skin_radius_mm * math.sin(math.radians(geometry.visible_half_angle_deg))
    places = np.array([o.place_mm for o in observations])
    rho2 = np.minimum((places**2).sum(axis=1) / visible_mm**2, 1.5)
    columns = [
        np.ones(len(observations)),
        np.log([o.change_grey for o in observations]),
        rho2,
        rho2**2,
        np.log([o.radius_mm / scale for o in observations]),
        np.log([o.bright_mm2 / scale**2 for o in observations]),
        np.log([o.brightening_grey for o in observations]),
    ]
    others = sorted({o.indenter for o in observations} - {""})
    columns += [np.array([float(o.indenter == name) for o in observations]) for name in others]
    return np.stack(columns, axis=1)
