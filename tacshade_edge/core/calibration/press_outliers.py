"""Presses that do not agree with what is stated of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.press_observation import PressObservation, with_stated_place
from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.core.calibration.travel_fit import OUTLIER_DEVIATIONS, leave_one_out
from tacshade_edge.types import Geometry

# A place is an outlier when it is further off than so many times the median press, with bounds in mm on the nominal
# skin. What this finds, and finds wrongly: tools/bench_calibration.py.
_PLACE_MEDIANS, _PLACE_LEAST_MM, _PLACE_MOST_MM = 3.0, 3.5, 5.0
# With fewer presses no fit tells which is wrong.
_LEAST_PRESSES = 3


@dataclass(frozen=True, slots=True)
class Outlier:
    """A press that does not agree: its index, and why, for a person."""

    index: int
    reason: str


def outliers(observations: Sequence[PressObservation], geometry: Geometry) -> tuple[Outlier, ...]:
    """Presses whose place, or whose depth predicted from all the others, is far from what is stated."""
    reasons = _misplaced(observations, geometry)
    while True:
        # Without the worst, what is left may show more: many wrong presses widen the deviation that hides them.
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
        f"{press.name}: depth {press.depth_mm:.2f} mm is stated, {press.depth_mm + error_mm:.2f} mm is what "
        f"the other presses say of {press.indenter or f'a ball of {press.radius_mm:g} mm'}"
    )


def _misplaced(observations: Sequence[PressObservation], geometry: Geometry) -> dict[int, str]:
    """Presses far from where they are stated, beyond what all of them are."""
    errors = [o.place_error_mm(*o.place_mm) for o in observations]  # 0 where no place is stated
    stated = [o.place_error_mm(*o.place_mm) for o in with_stated_place(observations)]
    if not stated:
        return {}
    scale = skin_scale(geometry)
    limit_mm = np.clip(_PLACE_MEDIANS * np.median(stated), _PLACE_LEAST_MM * scale, _PLACE_MOST_MM * scale)
    return {k: _place_reason(observations[k]) for k, error in enumerate(errors) if error > limit_mm}


def _place_reason(press: PressObservation) -> str:
    x_mm, y_mm = press.place_mm
    return (
        f"{press.name}: x {x_mm:.1f}, y {y_mm:.1f} mm is stated, "
        f"x {press.located_x_mm:.1f}, y {press.located_y_mm:.1f} mm is what the image shows"
    )
