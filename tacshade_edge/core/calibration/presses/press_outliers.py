"""Find presses that disagree with their stated values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.observation.press_observation import PressObservation, with_stated_place
from tacshade_edge.core.calibration.presses.travel_fit import OUTLIER_DEVIATIONS, leave_one_out
from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.types import Geometry

# A place is an outlier beyond this many times the median error, with bounds in mm on the nominal skin.
# tools/studies/calibration.py measures what this finds, rightly and wrongly.
_PLACE_MEDIANS, _PLACE_LEAST_MM, _PLACE_MOST_MM = 3.0, 3.5, 5.0
# The same for presses located by a network.
_SEEN_MEDIANS, _SEEN_LEAST_MM = 4.0, 2.0
# A ball is an outlier if its size differs from the median press's by this many robust deviations of the logarithms and
# at least this factor; shallower presses (mm on the nominal skin) do not show the radius.
_BALL_DEVIATIONS, _BALL_LEAST, _BALL_DEPTH_MM = 4.0, 1.55, 0.8
# A small ball may look larger than it is, so a larger look counts only if the stated radius fits this many times worse.
_LARGER_MISFIT_RATIO = 4.0
# With fewer presses, no fit shows which one is wrong.
_LEAST_PRESSES = 3


@dataclass(frozen=True, slots=True)
class Outlier:
    """A press that disagrees: its index and the reason, as a message."""

    index: int
    reason: str


def outliers(observations: Sequence[PressObservation], geometry: Geometry) -> tuple[Outlier, ...]:
    """Presses with a stated place, ball or depth far from the shown one; all others together predict the depth."""
    reasons = _misplaced(observations, geometry) | _of_another_size(observations, geometry)
    while True:
        # Repeat without the worst: many wrong presses widen the deviation and so hide each other.
        rest = [k for k in range(len(observations)) if k not in reasons]
        if len(rest) < _LEAST_PRESSES:
            break
        left_out = leave_one_out([observations[k] for k in rest], geometry)
        found = {
            k: _depth_reason(observations[k], float(error))
            for k, error, deviations in zip(rest, left_out.error_mm, left_out.deviations, strict=True)
            if deviations > OUTLIER_DEVIATIONS
        }
        if not found:
            break
        reasons |= found
    return tuple(Outlier(k, reasons[k]) for k in sorted(reasons))


def _depth_reason(press: PressObservation, error_mm: float) -> str:
    return (
        f"{press.name}: found a depth of {press.depth_mm:.2f} mm, expected {press.depth_mm + error_mm:.2f} mm by "
        f"the other presses with {press.indenter or f'a ball of {press.radius_mm:g} mm'}"
    )


def _misplaced(observations: Sequence[PressObservation], geometry: Geometry) -> dict[int, str]:
    """Presses much further from their stated places than most."""
    errors = [o.place_error_mm(*o.place_mm) for o in observations]  # 0 if no place is stated
    scale = skin_scale(geometry)
    reasons: dict[int, str] = {}
    for is_seen, medians, least_mm in ((True, _SEEN_MEDIANS, _SEEN_LEAST_MM), (False, _PLACE_MEDIANS, _PLACE_LEAST_MM)):
        alike = [k for k, o in enumerate(observations) if o.is_seen == is_seen]
        stated = [o.place_error_mm(*o.place_mm) for o in with_stated_place([observations[k] for k in alike])]
        if stated:
            limit_mm = np.clip(medians * np.median(stated), least_mm * scale, _PLACE_MOST_MM * scale)
            reasons |= {k: _place_reason(observations[k]) for k in alike if errors[k] > limit_mm}
    return reasons


def _of_another_size(observations: Sequence[PressObservation], geometry: Geometry) -> dict[int, str]:
    """Balls that look larger or smaller than stated, compared with the median ball."""
    logs = {k: math.log(o.ball_factor) for k, o in enumerate(observations) if math.isfinite(o.ball_factor)}
    if len(logs) < _LEAST_PRESSES:
        return {}
    middle = float(np.median(list(logs.values())))
    deviation = 1.4826 * float(np.median([abs(log - middle) for log in logs.values()]))
    limit, shallow_mm = max(_BALL_DEVIATIONS * deviation, math.log(_BALL_LEAST)), _BALL_DEPTH_MM * skin_scale(geometry)
    return {
        k: _ball_reason(observations[k], math.exp(log - middle))
        for k, log in logs.items()
        if abs(log - middle) > limit
        and observations[k].depth_mm > shallow_mm
        and (log < middle or observations[k].misfit_ratio > _LARGER_MISFIT_RATIO)
    }


def _ball_reason(press: PressObservation, factor: float) -> str:
    """A message that the ball of a press looks `factor` times as large as stated."""
    asked = ""
    if factor < 1:
        asked = f": is {press.radius_mm:g} mm its diameter?"
    return (
        f"{press.name}: found a ball of {press.radius_mm:g} mm, expected about {factor * press.radius_mm:.1f} mm, "
        f"as the image shows{asked}"
    )


def _place_reason(press: PressObservation) -> str:
    x_mm, y_mm = press.place_mm
    return (
        f"{press.name}: found x {x_mm:.1f}, y {y_mm:.1f} mm, "
        f"expected x {press.located_x_mm:.1f}, y {press.located_y_mm:.1f} mm, as the image shows"
    )
