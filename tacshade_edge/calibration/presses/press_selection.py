"""Select the presses for a fit: not those that disagree with their stated values,
or with what all others predict.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.calibration.inputs import Contradiction, ContradictionError, KnownPress
from tacshade_edge.calibration.observation import (
    PressObservation,
    first_touch_mm,
    with_stated_place,
)
from tacshade_edge.calibration.presses.press_check import PressCheck, PressLook
from tacshade_edge.calibration.presses.sensor_check import wrong_keys
from tacshade_edge.calibration.presses.table_check import (
    gross_mistakes,
    other_polarity,
    polarity_hint,
)
from tacshade_edge.errors import ConfigError
from tacshade_edge.sensor.depth import Network
from tacshade_edge.sensor.depth.learned import Inverse
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.types import F64, Calibration, Geometry, Polarity

OUTLIER_DEVIATIONS = 4.0
"""A press is an outlier beyond this many standard deviations of all presses."""

# Regression of log(travel) on 1, log χ, ρ², ρ⁴, log ball radius, log brightened area, log
# brightening, and 1 for each other indenter, on the nominal skin: usual weights (0 for the
# indenters), which count where the presses leave a weight open, and the strength of the pull
# towards them.
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
# A place is an outlier beyond this many times the median error, with bounds in mm on the nominal
# skin. tools/studies/calibration.py measures what this finds, rightly and wrongly.
_PLACE_MEDIANS, _PLACE_LEAST_MM, _PLACE_MOST_MM = 3.0, 3.5, 5.0
# The same for presses located by a network.
_SEEN_MEDIANS, _SEEN_LEAST_MM = 4.0, 2.0
# A ball is an outlier if its size differs from the median press's by this many robust deviations of
# the logarithms and at least this factor; shallower presses (mm on the nominal skin) do not show
# the radius.
_BALL_DEVIATIONS, _BALL_LEAST, _BALL_DEPTH_MM = 4.0, 1.55, 0.8
# A small ball may look larger than it is, so a larger look counts only
# if the stated radius fits this many times worse.
_LARGER_MISFIT_RATIO = 4.0
# With fewer presses, no fit shows which one is wrong.
_LEAST_PRESSES = 3


def leave_one_out(observations: Sequence[PressObservation], geometry: Geometry) -> tuple[F64, F64]:
    """Fit all presses robustly, and predict each from the others: the residuals (N,), predicted
    less stated travel in mm, and their sizes in robust standard deviations. The travel from first
    touch is a power law of what the image shows. Iteration by Holland and Welsch (Comm. Stat. A 6,
    1977) with Huber's weights, 0 beyond `OUTLIER_DEVIATIONS`; a pull towards usual weights (Hoerl
    and Kennard, Technometrics 12, 1970); residuals from the leverage by D. M. Allen (Technometrics
    16, 1974).
    """
    scale = skin_scale(geometry)
    features = _features(observations, geometry)
    depth_mm = np.array([o.depth_mm for o in observations])
    travel = np.maximum(
        (depth_mm - first_touch_mm(observations, geometry)) / scale, _LEAST_TRAVEL_MM
    )
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
        residual = log_travel - features @ np.linalg.solve(
            normal, weighted.T @ log_travel + ridge @ usual
        )
        deviation = np.hypot(
            max(1.4826 * float(np.median(np.abs(residual))), _LEAST_DEVIATION), least
        )
        z = np.abs(residual) / deviation
        kept = np.where(z < _HUBER, 1.0, _HUBER / np.maximum(z, _HUBER)) * (z < OUTLIER_DEVIATIONS)
        if not kept.any():
            break
        weight = trust * kept
    leverage = weight * np.einsum("ij,ij->i", features, np.linalg.solve(normal, features.T).T)
    rest = 1 - np.minimum(leverage, _MAX_LEVERAGE)
    without = residual / rest
    error = (np.exp(np.clip(-without, -5, 5)) - 1) * travel * scale
    return error, np.abs(without) * np.sqrt(rest) / deviation


def agreement_mae_mm(observations: Sequence[PressObservation], geometry: Geometry) -> float:
    """Mean error of the depth of a press, predicted from all the others with indenter
    and place known; mm.
    """
    return float(np.mean(np.abs(leave_one_out(observations, geometry)[0])))


def _features(observations: Sequence[PressObservation], geometry: Geometry) -> F64:
    scale = skin_scale(geometry)
    visible_mm = geometry.visible_radius_mm
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


def outliers(observations: Sequence[PressObservation], geometry: Geometry) -> dict[int, str]:
    """A message for each press, by index, whose place,
    ball or depth differs from what its image or the others show.
    """
    reasons = _misplaced(observations, geometry) | _of_another_size(observations, geometry)
    while True:
        # Repeat without the worst: many wrong presses widen the deviation and so hide each other.
        rest = [k for k in range(len(observations)) if k not in reasons]
        if len(rest) < _LEAST_PRESSES:
            break
        left_out = zip(rest, *leave_one_out([observations[k] for k in rest], geometry), strict=True)
        found = {
            k: float(error) for k, error, deviations in left_out if deviations > OUTLIER_DEVIATIONS
        }
        if not found:
            break
        for k, error_mm in found.items():
            o = observations[k]
            by = o.indenter or f"a ball of {o.radius_mm:g} mm"
            expected = f"expected {o.depth_mm + error_mm:.2f} mm by the other presses with {by}"
            reasons[k] = f"{o.name}: found a depth of {o.depth_mm:.2f} mm, {expected}"
    return dict(sorted(reasons.items()))


def _misplaced(observations: Sequence[PressObservation], geometry: Geometry) -> dict[int, str]:
    """Presses much further from their stated places than most."""
    errors = [o.place_error_mm(*o.place_mm) for o in observations]  # 0 if no place is stated
    scale = skin_scale(geometry)
    reasons: dict[int, str] = {}
    for is_seen, medians, least_mm in (
        (True, _SEEN_MEDIANS, _SEEN_LEAST_MM),
        (False, _PLACE_MEDIANS, _PLACE_LEAST_MM),
    ):
        alike = [k for k, o in enumerate(observations) if o.is_seen == is_seen]
        stated = [
            o.place_error_mm(*o.place_mm)
            for o in with_stated_place([observations[k] for k in alike])
        ]
        if stated:
            limit_mm = np.clip(
                medians * np.median(stated), least_mm * scale, _PLACE_MOST_MM * scale
            )
            for k in (k for k in alike if errors[k] > limit_mm):
                o, (x_mm, y_mm) = observations[k], observations[k].place_mm
                expected = (
                    f"expected x {o.located_x_mm:.1f}, y {o.located_y_mm:.1f} mm, "
                    "as the image shows"
                )
                reasons[k] = f"{o.name}: found x {x_mm:.1f}, y {y_mm:.1f} mm, {expected}"
    return reasons


def _of_another_size(
    observations: Sequence[PressObservation], geometry: Geometry
) -> dict[int, str]:
    """Balls that look larger or smaller than stated, compared with the median ball."""
    logs = {
        k: math.log(o.ball_factor)
        for k, o in enumerate(observations)
        if math.isfinite(o.ball_factor)
    }
    if len(logs) < _LEAST_PRESSES:
        return {}
    middle = float(np.median(list(logs.values())))
    deviation = 1.4826 * float(np.median([abs(log - middle) for log in logs.values()]))
    limit, shallow_mm = (
        max(_BALL_DEVIATIONS * deviation, math.log(_BALL_LEAST)),
        _BALL_DEPTH_MM * skin_scale(geometry),
    )
    reasons = {}
    for k, log in logs.items():
        o = observations[k]
        is_sure = log < middle or o.misfit_ratio > _LARGER_MISFIT_RATIO
        if abs(log - middle) > limit and o.depth_mm > shallow_mm and is_sure:
            expected = (
                f"expected about {math.exp(log - middle) * o.radius_mm:.1f} mm, as the image shows"
            )
            asked = f": is {o.radius_mm:g} mm its diameter?" if log < middle else ""
            reasons[k] = f"{o.name}: found a ball of {o.radius_mm:g} mm, {expected}{asked}"
    return reasons


MIN_PRESSES = 8
# If more of the presses disagree, the whole table is wrong.
_MAX_LEFT_OUT = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The presses to fit, their observations, warnings about all presses,
    and `wrong_keys` of SENSOR.yaml.
    """

    presses: tuple[KnownPress, ...]
    observations: tuple[PressObservation, ...]
    warnings: tuple[str, ...]
    polarity: Polarity
    wrong_keys: Contradiction | None
    answers: tuple[Inverse | None, ...]


def select_presses(
    unloaded: Calibration,
    presses: Sequence[KnownPress],
    network: Network | None = None,
    polarity_stated: bool = True,
) -> Selection:
    """Leave out presses without contact, with a moved camera, or that disagree.

    A polarity that was not stated is the one that fits the places. Raises ConfigError on a gross
    mistake in the whole table or the sensor's description, and on too few presses or too many left
    out, all of which it names.
    """
    if len(presses) < MIN_PRESSES:
        raise ConfigError(
            f"found {len(presses)} presses, expected at least {MIN_PRESSES} (20 give better "
            "results)"
        )
    geometry = unloaded.geometry
    check = PressCheck(unloaded, network)
    pressed: list[tuple[KnownPress, PressLook]] = []
    left_out: list[str] = []
    warnings: list[str] = []
    for press in presses:
        if impossible := _impossible(unloaded, press):
            left_out.append(f"{press.name}: {impossible}")
            continue
        look = check.look(press.image)
        judged = check.judge(look)
        if judged.unusable:
            left_out.append(f"{press.name}: {judged.unusable}")
        elif judged.moved:
            left_out.append(f"{press.name}: {judged.moved} since the references were taken")
        elif not judged.in_contact:
            left_out.append(
                f"{press.name}: the image shows no contact, expected one {press.depth_mm} mm deep"
            )
        else:
            pressed.append((press, look))
            if judged.changed:
                warnings.append(f"{press.name}: {judged.changed} since the references were taken")
    observations = [check.observe(look.maps, press) for press, look in pressed]
    polarity = unloaded.polarity
    if len(observations) >= MIN_PRESSES:
        otherwise = [check.observe(look.maps.inverted(), press) for press, look in pressed]
        if hint := polarity_hint(observations, otherwise, polarity):
            if polarity_stated:
                raise ContradictionError(hint)
            observations, polarity = otherwise, other_polarity(polarity)
    observations = [
        check.see(look, each, press)
        for each, (press, look) in zip(observations, pressed, strict=True)
    ]
    keys = wrong_keys(observations, geometry)
    if len(observations) >= MIN_PRESSES and (mistakes := gross_mistakes(observations, geometry)):
        # Balls seem to have another size if the skin has.
        is_of_balls = mistakes[0].key == "radius_mm"
        raise ContradictionError(*((keys,) if keys and is_of_balls else mistakes))
    warnings += [str(keys)] if keys else []
    disagreeing = outliers(observations, geometry)
    left_out += disagreeing.values()
    usable = [k for k in range(len(pressed)) if k not in disagreeing]
    if len(left_out) > _MAX_LEFT_OUT * len(presses) or len(usable) < MIN_PRESSES:
        found = (
            f"{len(left_out)} of {len(presses)} presses are unusable; the first one: {left_out[0]}"
        )
        raise ConfigError(found, others=left_out[1:])
    return Selection(
        tuple(pressed[k][0] for k in usable),
        tuple(observations[k] for k in usable),
        (*warnings, *(f"{reason}; left out" for reason in left_out)),
        polarity,
        keys,
        tuple(pressed[k][1].answer for k in usable),
    )


def _impossible(calibration: Calibration, press: KnownPress) -> str:
    """Why this cannot be a press of the sensor; empty if it can."""
    most_mm = calibration.geometry.height_max_mm
    if press.image.shape[:2] != (calibration.image_height_px, calibration.image_width_px):
        expected = (
            f"expected {calibration.image_width_px}x{calibration.image_height_px} px as in the "
            "reference"
        )
        return f"found {press.image.shape[1]}x{press.image.shape[0]} px, {expected}"
    if not 0 < press.depth_mm < most_mm or not (press.indenter or press.radius_mm > 0):
        found = f"found a depth of {press.depth_mm} mm and a ball radius of {press.radius_mm} mm"
        return f"{found}, expected a depth above 0 and below {most_mm:g} mm and a radius above 0"
    return ""
