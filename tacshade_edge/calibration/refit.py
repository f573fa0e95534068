"""Refit a learned profile to known presses in closed form, and measure its errors on presses left
out of the refit. A network is off on a sensor that it never saw by a nearly constant factor. Each
press shows it where the indenter's surface is known and the network sees contact. The mean of the
logarithms is robust (P. J. Huber, Ann. Math. Stat. 35, 1964) and shrinks towards 0 as their spread
allows, and as shapes differ: a small factor is nearly dropped, a large one stays; its own square is
the prior's variance (empirical Bayes). One that raises heights shrinks more, because on other
shapes and dragged contacts it gains nothing. The error scale is a sensor's factor on σ
(`sensor.depth.sigma`), from the quantile of errors that the 90 % interval must hold, as in split
conformal prediction (Vovk, Gammerman and Shafer 2005). Later contacts have other shapes and larger
errors, so a line fitted on simulated sensors converts the quantile to the scale.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode, finding
from tacshade_edge.calibration.indenters import Placed, ball_along, known_height
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.sensor.depth import Network
from tacshade_edge.sensor.depth.learned import Inverse, LearnedSolver, untrusted_cells
from tacshade_edge.sensor.depth.sigma import INTERVAL_90, SigmaModel, sigma_of_scale_1, terms
from tacshade_edge.sensor.frame_check.foreign_skin import UNTRUSTED_UNLEARNT, untrusted_part
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import disc_rays, skin_points
from tacshade_edge.sensor.geometry.disc_map import rays_in_image, skin_scale
from tacshade_edge.sensor.image.preprocess import Preprocessor
from tacshade_edge.sensor.profiles import Profile
from tacshade_edge.types import F32, F64, Bool, Calibration, Geometry, ProfileFit

LOWERING_DEVIATION, RAISING_DEVIATION = 0.08, 0.3
"""Standard deviations of log factor from that of other shapes, also dragged, where presses lower
heights and where they raise them. With 0.08 for both, factors above 1 made errors on Table I's
objects greater on 14 simulated sensors of five families, up to twice as great where they were
dragged; deviations of 0.2 to 0.4 for them gain the same (docs/results/factors.md).
"""
# Least standard deviation of log factor over the presses of a sensor.
_LEAST_DEVIATION = 0.05
_HUBER, _ITERATIONS = 1.5, 20
# Fewer cells make no usable contact, fewer presses no usable factor.
LEAST_CELLS, LEAST_PRESSES = 12, 5
# Cells count only where the network and the indenter are deeper than this (mm on the nominal skin).
LEAST_FOUND_MM, LEAST_TRUE_MM = 0.05, 0.1
# The error of h grows with depth; beyond this depth it is mostly proportional
# (mm on the nominal skin).
PROPORTIONAL_MM = 0.5
# No known sensor needs a factor outside this range.
FACTOR_RANGE = (0.3, 3.0)
_SCALE_RANGE = (0.2, 20.0)
# Part of the median press's disc: a warning is due if the network cannot explain more than this.
_UNLIKE_PART = 0.03


def contact_direction(geometry: Geometry, inverse: Inverse) -> F64 | None:
    """The unit vector from O to the middle of the contact, on a pad that middle;
    None if there is hardly a contact.
    """
    rays = disc_rays(disc_map.map_grid(geometry.disc, len(inverse.height_mm)), geometry)
    contact = (inverse.contact_logit > 0) & rays.inside
    if np.count_nonzero(contact) < LEAST_CELLS:
        return None
    points = skin_points(np.maximum(inverse.height_mm, 0), rays, geometry)
    middle = points[contact].astype(np.float64).mean(axis=0)
    return np.asarray(middle if geometry.skin == "pad" else middle / np.linalg.norm(middle))


def press_factor(
    inverse: Inverse, geometry: Geometry, placed: Placed
) -> tuple[float, float] | None:
    """The weight of a press in `fit_factor` and its factor;
    None if contact and indenter hardly overlap.
    """
    truth, use = known_cells(inverse, geometry, placed)
    cells = int(np.count_nonzero(use))
    if cells < LEAST_CELLS:
        return None
    # All presses count alike, except that deep ones count a little less:
    # their error in mm is larger.
    depth_mm = placed.depth_max_mm(geometry.skin_radius_mm) / skin_scale(geometry)
    weight = 1 / math.sqrt(cells * (PROPORTIONAL_MM + depth_mm))
    found, target = (each[use].astype(np.float64) * weight for each in (inverse.height_mm, truth))
    square = float(found @ found)
    return square, float(found @ target) / square


def known_cells(inverse: Inverse, geometry: Geometry, placed: Placed) -> tuple[F32, Bool]:
    """`known_height` of an indenter, and the cells where it overlaps the network's contact."""
    height, truth = inverse.height_mm, known_height(geometry, placed, len(inverse.height_mm))
    scale = skin_scale(geometry)
    use = (inverse.contact_logit > 0) & np.isfinite(height)
    # Near the edge of a contact both are close to 0, and their ratio is noise.
    use &= (height > LEAST_FOUND_MM * scale) & (np.nan_to_num(truth) > LEAST_TRUE_MM * scale)
    return truth, use


def fit_factor(presses: Sequence[tuple[float, float]]) -> float | None:
    """Fit the factor on h by a robust mean over presses (`press_factor`) and a prior;
    None if there are too few.
    """
    if len(presses) < LEAST_PRESSES:
        return None
    squares, factors = np.array(presses).T
    # Logarithms, so that twice and half as much are errors of one size.
    logs = np.log(np.maximum(factors, np.finfo(float).tiny))
    middle = _weighted_quantile(logs, squares, 0.5)
    deviation = max(
        1.4826 * _weighted_quantile(np.abs(logs - middle), squares, 0.5), _LEAST_DEVIATION
    )
    for _ in range(_ITERATIONS):
        weight = squares * np.minimum(
            1, _HUBER * deviation / np.maximum(np.abs(logs - middle), 1e-9)
        )
        middle = float(weight @ logs / weight.sum())
    effective_presses = float(weight.sum() ** 2 / (weight @ weight))
    # m² stands for the prior's variance, so the shrunk mean is m · m² / (m² + doubt).
    of_shapes = RAISING_DEVIATION if middle > 0 else LOWERING_DEVIATION
    doubt = of_shapes**2 + deviation**2 / effective_presses
    return min(max(math.exp(middle**3 / (middle**2 + doubt)), FACTOR_RANGE[0]), FACTOR_RANGE[1])


def _weighted_quantile(values: F64, weights: F64, part: float) -> float:
    order = np.argsort(values)
    below = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(below, part * below[-1])])


def errors_in_sigma(
    model: SigmaModel,
    height_mm: F32,
    true_mm: F32,
    contact_logit: F32,
    untrusted_logit: F32,
    known: Bool,
    geometry: Geometry,
) -> F64:
    """|error| over σ of scale 1 of a press, at the cells with known height: (N,)."""
    x = terms(height_mm, contact_logit, untrusted_logit, known, geometry)
    off = np.abs(height_mm[known].astype(np.float64) - true_mm[known])
    return np.asarray(off / sigma_of_scale_1(model, x, geometry))


def error_scale(model: SigmaModel, presses: Sequence[F64]) -> float:
    """The error scale from `errors_in_sigma` of at least one press, none of them empty;
    presses count alike.
    """
    scale = math.exp(model.press_offset + model.press_slope * math.log(press_q(presses)))
    return min(max(scale, _SCALE_RANGE[0]), _SCALE_RANGE[1])


def press_q(presses: Sequence[F64]) -> float:
    """The 90 % quantile of the presses' errors, in half widths of the 90 % interval of scale 1;
    above 0.
    """
    # By presses rather than cells: a deep press has many times the cells of a shallow one.
    errors = np.concatenate(presses)
    weights = np.concatenate([np.full(len(each), 1 / len(each)) for each in presses])
    return max(_weighted_quantile(errors, weights, 0.9) / INTERVAL_90, 1e-3)


@dataclass(frozen=True, slots=True)
class Refit:
    """A profile refitted to presses."""

    factor: float  # on h
    fit: ProfileFit
    errors_mm: tuple[
        tuple[str, float], ...
    ]  # name of a press, and greatest h found with the others' factor less true
    found_mm: tuple[float, ...]  # greatest h without a refit
    placed: tuple[Placed, ...]  # indenters at their stated places
    error_scale: float | None  # factor on σ; None if the network has no model of its errors
    warnings: tuple[CalibrationFinding, ...]


def refit_profile(
    calibration: Calibration,
    profile: Profile,
    network: Network,
    presses: Sequence[KnownPress],
    answers: Sequence[Inverse | None] = (),
) -> Refit | None:
    """Refit a profile; None if its network finds too few of the contacts.

    `answers`: the network's to each press, if it looked at them before.
    """
    geometry = calibration.geometry
    preprocessor = Preprocessor(calibration, profile)
    solver = LearnedSolver(preprocessor, network)
    inside = rays_in_image(solver.grid, calibration).inside
    inverses = [
        answer or solver.inverse(preprocessor.preprocess(preprocessor.grey(press.image)))
        for press, answer in zip_longest(presses, answers)
    ]
    parts = [
        untrusted_part(untrusted_cells(each, len(each.height_mm)), inside) for each in inverses
    ]
    shown = [
        _shown(geometry, inverse, press)
        for press, inverse, part in zip(presses, inverses, parts, strict=True)
        if part <= UNTRUSTED_UNLEARNT
    ]
    used = [press for press in shown if press]
    rows = [press.row for press in used]
    factor = fit_factor(rows)
    if factor is None:
        return None
    errors, in_sigma = [], []
    for k, press in enumerate(used):
        # A press must not judge a factor that it helped to fit.
        without = fit_factor(rows[:k] + rows[k + 1 :]) or 1.0
        true_mm = press.placed.depth_max_mm(geometry.skin_radius_mm)
        errors.append(float(press.found_mm * np.float32(without)) - true_mm)
        if network.sigma is not None:
            in_sigma.append(_errors_in_sigma(network.sigma, press, without, inside, geometry))
    off = np.abs(errors)
    return Refit(
        factor,
        ProfileFit(len(rows), float(off.mean()), float(off.max())),
        tuple((press.name, error) for press, error in zip(used, errors, strict=True)),
        tuple(float(press.found_mm) for press in used),
        tuple(press.placed for press in used),
        None if network.sigma is None else error_scale(network.sigma, in_sigma),
        _doubts(presses, parts),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """A press in which the network sees the indenter where it is, and its row of `fit_factor`."""

    name: str
    inverse: Inverse
    placed: Placed
    row: tuple[float, float]
    found_mm: np.float32  # greatest h, without a factor


def _shown(geometry: Geometry, inverse: Inverse, press: KnownPress) -> _Shown | None:
    placed = placed_press(geometry, inverse, press)
    row = press_factor(inverse, geometry, placed) if placed else None
    if placed is None or row is None:
        return None
    greatest_mm = inverse.height_mm[inverse.contact_logit > 0].max()
    return _Shown(press.name, inverse, placed, row, greatest_mm)


def _doubts(
    presses: Sequence[KnownPress], parts: Sequence[float]
) -> tuple[CalibrationFinding, ...]:
    """What the parts of the presses that the network does not trust say of them, and of all."""
    doubts = [
        finding(FindingCode.OTHER_SKIN, press.name, left_out=True, percent=100 * part)
        for press, part in zip(presses, parts, strict=True)
        if part > UNTRUSTED_UNLEARNT
    ]
    if (unlike := float(np.median(parts))) > _UNLIKE_PART:
        doubts.append(finding(FindingCode.UNKNOWN_KIND, percent=100 * unlike))
    return tuple(doubts)


def _errors_in_sigma(
    model: SigmaModel, press: _Shown, factor: float, inside: Bool, geometry: Geometry
) -> F64:
    """|error| over σ of scale 1 of a press, at the cells of `known_cells` inside the image."""
    inverse = press.inverse
    # As in a reconstructed frame: at least 0, and none outside the image.
    height = np.where(
        inside, np.maximum(np.nan_to_num(inverse.height_mm * np.float32(factor)), 0), 0
    )
    truth, use = known_cells(inverse, geometry, press.placed)
    return errors_in_sigma(
        model,
        height.astype(np.float32),
        truth,
        inverse.contact_logit,
        inverse.untrusted_logit,
        use,
        geometry,
    )


def placed_press(geometry: Geometry, inverse: Inverse, press: KnownPress) -> Placed | None:
    """The indenter of a press at its stated place;
    a ball without one is located, or None if that fails.
    """
    if press.indenter or press.x_mm is not None:
        return press.placed(geometry.skin_radius_mm)
    along = contact_direction(geometry, inverse)
    return (
        None
        if along is None
        else ball_along(geometry.skin_radius_mm, along, press.depth_mm, press.radius_mm)
    )
