"""Select the presses for a fit: not those that disagree with their stated values,
or with what all others predict.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode, finding
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.observation import (
    PressObservation,
    first_touch_mm,
    with_stated_place,
)
from tacshade_edge.calibration.presses.press_check import Judgement, PressCheck, PressLook
from tacshade_edge.calibration.presses.sensor_check import wrong_keys
from tacshade_edge.calibration.presses.table_check import (
    gross_mistakes,
    other_polarity,
    polarity_hint,
)
from tacshade_edge.calibration.sentences import FindingError
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
    # Clipped, so that absurd tables give finite errors.
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
    # A place far outside is a mistake of its own; its square must not bend the fit of all.
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


def outliers(
    observations: Sequence[PressObservation], geometry: Geometry
) -> dict[int, CalibrationFinding]:
    """The presses, by index, whose place, ball or depth differs from what their image or the
    others show.
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
            reasons[k] = finding(
                FindingCode.OTHER_DEPTH,
                o.name,
                found_mm=o.depth_mm,
                expected_mm=o.depth_mm + error_mm,
                of=o.indenter or o.radius_mm,
            )
    return dict(sorted(reasons.items()))


def _misplaced(
    observations: Sequence[PressObservation], geometry: Geometry
) -> dict[int, CalibrationFinding]:
    """Presses much further from their stated places than most."""
    errors = [o.place_error_mm(*o.place_mm) for o in observations]  # 0 if no place is stated
    scale = skin_scale(geometry)
    reasons = dict[int, CalibrationFinding]()
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
                reasons[k] = finding(
                    FindingCode.OTHER_PLACE,
                    o.name,
                    found_x_mm=x_mm,
                    found_y_mm=y_mm,
                    expected_x_mm=o.located_x_mm,
                    expected_y_mm=o.located_y_mm,
                )
    return reasons


def _of_another_size(
    observations: Sequence[PressObservation], geometry: Geometry
) -> dict[int, CalibrationFinding]:
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
        # Against the median ball, not 1: on a stiff skin all look smaller than they are.
        if abs(log - middle) > limit and o.depth_mm > shallow_mm and is_sure:
            reasons[k] = finding(
                FindingCode.SMALLER_BALL if log < middle else FindingCode.LARGER_BALL,
                o.name,
                found_mm=o.radius_mm,
                expected_mm=math.exp(log - middle) * o.radius_mm,
            )
    return reasons


MIN_PRESSES = 8
# If more of the presses disagree, the whole table is wrong.
_MAX_LEFT_OUT = 0.25
_SIZES_OF_BALLS = (FindingCode.DIAMETERS, FindingCode.HALVED_RADII)


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The presses to fit, their observations, warnings about all presses,
    and `wrong_keys` of SENSOR.yaml.
    """

    presses: tuple[KnownPress, ...]
    observations: tuple[PressObservation, ...]
    warnings: tuple[CalibrationFinding, ...]
    polarity: Polarity
    wrong_keys: CalibrationFinding | None
    answers: tuple[Inverse | None, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Usable:
    """Presses that show a contact, with their images, and what was found of them and the others."""

    pressed: list[tuple[KnownPress, PressLook]]
    warnings: list[CalibrationFinding]
    left_out: list[CalibrationFinding]


def select_presses(
    unloaded: Calibration,
    presses: Sequence[KnownPress],
    network: Network | None = None,
    *,
    polarity_stated: bool = True,
) -> Selection:
    """Leave out presses without contact, with a moved camera, or that disagree.

    A polarity that was not stated is the one that fits the places. Raises FindingError on a gross
    mistake in the whole table or the sensor's description, and on too few presses or too many left
    out, all of which it names.
    """
    if len(presses) < MIN_PRESSES:
        raise FindingError(
            finding(FindingCode.FEW_PRESSES, found=len(presses), expected=MIN_PRESSES)
        )
    check = PressCheck(unloaded, network)
    usable = _usable(unloaded, check, presses)
    observations, polarity = _observed(
        check, usable.pressed, unloaded.polarity, polarity_stated=polarity_stated
    )
    keys = wrong_keys(observations, unloaded.geometry)
    _refuse_gross_mistakes(presses, observations, unloaded.geometry, keys)
    disagreeing = outliers(observations, unloaded.geometry)
    left_out = [*usable.left_out, *disagreeing.values()]
    kept = [k for k in range(len(usable.pressed)) if k not in disagreeing]
    if len(left_out) > _MAX_LEFT_OUT * len(presses) or len(kept) < MIN_PRESSES:
        raise FindingError(
            finding(
                FindingCode.MANY_LEFT_OUT,
                unusable=len(left_out),
                presses=len(presses),
                first=left_out[0],
            ),
            others=left_out[1:],
        )
    doubted_keys = [keys] if keys else []
    excluded = [replace(one, left_out=True) for one in left_out]
    return Selection(
        tuple(usable.pressed[k][0] for k in kept),
        tuple(observations[k] for k in kept),
        (*usable.warnings, *doubted_keys, *excluded),
        polarity,
        keys,
        tuple(usable.pressed[k][1].answer for k in kept),
    )


def _usable(unloaded: Calibration, check: PressCheck, presses: Sequence[KnownPress]) -> _Usable:
    """Look at each press that can be one of the sensor."""
    sorted_out = _Usable([], [], [])
    for press in presses:
        if impossible := _impossible(unloaded, press):
            sorted_out.left_out.append(impossible)
            continue
        look = check.look(press.image)
        judged = check.judge(look)
        if unusable := _unusable(judged, press):
            sorted_out.left_out.append(unusable)
            continue
        sorted_out.pressed.append((press, look))
        if judged.changed:
            sorted_out.warnings.append(
                finding(FindingCode.PRESS_CHANGED, press.name, change=judged.changed)
            )
    return sorted_out


def _unusable(judged: Judgement, press: KnownPress) -> CalibrationFinding | None:
    """Why the image of a press cannot be used; None if it can."""
    if judged.unusable:
        return finding(FindingCode.PRESS_UNUSABLE, press.name, reason=judged.unusable)
    if judged.moved:
        return finding(FindingCode.PRESS_CHANGED, press.name, change=judged.moved)
    if not judged.in_contact:
        return finding(FindingCode.NO_CONTACT, press.name, depth_mm=press.depth_mm)
    return None


def _observed(
    check: PressCheck,
    pressed: Sequence[tuple[KnownPress, PressLook]],
    polarity: Polarity,
    *,
    polarity_stated: bool,
) -> tuple[list[PressObservation], Polarity]:
    """What the images show of the presses, and the polarity with which they do.

    Raises FindingError if that is not the stated one.
    """
    observations = [check.observe(look.maps, press) for press, look in pressed]
    if len(observations) >= MIN_PRESSES:
        otherwise = [check.observe(look.maps.inverted(), press) for press, look in pressed]
        if hint := polarity_hint(observations, otherwise, polarity):
            if polarity_stated:
                raise FindingError(hint)
            observations, polarity = otherwise, other_polarity(polarity)
    # Last, because what a network sees no longer shows the polarity.
    seen = [
        check.see(look, each, press)
        for each, (press, look) in zip(observations, pressed, strict=True)
    ]
    return seen, polarity


def _refuse_gross_mistakes(
    presses: Sequence[KnownPress],
    observations: Sequence[PressObservation],
    geometry: Geometry,
    keys: CalibrationFinding | None,
) -> None:
    """Raise FindingError for a mistake that all presses share."""
    if len(observations) < MIN_PRESSES:
        return
    if mistakes := gross_mistakes(observations, geometry, presses):
        # Balls seem to have another size if the skin has.
        is_skin = keys and mistakes[0].code in _SIZES_OF_BALLS
        raise FindingError(*([keys] if keys and is_skin else mistakes))


def _impossible(calibration: Calibration, press: KnownPress) -> CalibrationFinding | None:
    """Why this cannot be a press of the sensor; None if it can."""
    most_mm = calibration.geometry.height_max_mm
    if press.image.shape[:2] != (calibration.image_height_px, calibration.image_width_px):
        return finding(
            FindingCode.PRESS_SIZE,
            press.name,
            found=f"{press.image.shape[1]}x{press.image.shape[0]}",
            expected=f"{calibration.image_width_px}x{calibration.image_height_px}",
        )
    if not 0 < press.depth_mm < most_mm or not (press.indenter or press.radius_mm > 0):
        return finding(
            FindingCode.PRESS_IMPOSSIBLE,
            press.name,
            depth_mm=press.depth_mm,
            radius_mm=press.radius_mm,
            most_mm=most_mm,
        )
    return None
