"""Detect mistakes in a whole table of presses: another unit, other axes, another polarity."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tacshade_edge.core.calibration.observation.press_observation import PressObservation, with_stated_place
from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.types import Geometry, Polarity

# log(depth) of any sensor from log χ alone, on the nominal skin: coarse, but enough to detect a wrong unit.
_DEPTH_OF_CHANGE = -1.61, 1.3
_UNIT_FACTOR = 4.0
_UNITS = {"cm": 10.0, "inches": 25.4, "m": 1000.0}
# Suggest other axes if they leave less than this part of an error of at least this many mm on the nominal skin.
_AXES_PART, _AXES_LEAST_MM = 0.5, 1.75
_AXES_LEAST_PRESSES = 4
# Suggest the other polarity if it leaves less than the first part of an error that is at least the second part of the
# presses' distance from the middle.
_POLARITY_PART, _POLARITY_LEAST_PART = 0.6, 0.25
# Other readings of x and y: x is a·x + b·y, y is c·x + d·y.
_AXES = {
    "x and y are swapped": (0, 1, 1, 0),
    "x has the opposite sign": (-1, 0, 0, 1),
    "y has the opposite sign": (1, 0, 0, -1),
    "x and y have the opposite sign": (-1, 0, 0, -1),
    "x and y are swapped and have the opposite sign": (0, -1, -1, 0),
    "the axes are turned by 90 degrees": (0, -1, 1, 0),
    "the axes are turned by -90 degrees": (0, 1, -1, 0),
    "x and y are in cm": (10, 0, 0, 10),
    "x and y are in inches": (25.4, 0, 0, 25.4),
    "x and y are in m": (1000, 0, 0, 1000),
}


def table_hints(observations: Sequence[PressObservation], geometry: Geometry) -> tuple[str, ...]:
    """Hints at other readings of the whole table that fit clearly better than the stated one."""
    return tuple(hint for hint in (_unit_hint(observations, geometry), axes_hint(observations, geometry)) if hint)


def polarity_hint(observations: Sequence[PressObservation], other: Sequence[PressObservation], stated: Polarity) -> str:
    """A hint at the other polarity, if the places of the same presses then fit clearly better; empty otherwise."""
    found, else_found = (with_stated_place(presses) for presses in (observations, other))
    if len(found) < _AXES_LEAST_PRESSES:
        return ""
    error, else_error = _error_mm(found), _error_mm(else_found)
    reach = float(np.median([math.hypot(*o.place_mm) for o in found]))
    if else_error > _POLARITY_PART * error or error < _POLARITY_LEAST_PART * reach:
        return ""
    if else_error > min(_error_mm(found, axes) for axes in _AXES.values()):
        return ""  # other axes explain it better
    return (
        f"SENSOR.yaml: polarity: found {stated}, expected {'dark' if stated == 'bright' else 'bright'}: "
        f"the places fit within {else_error:.1f} mm with it, not {error:.1f} mm"
    )


def _unit_hint(observations: Sequence[PressObservation], geometry: Geometry) -> str:
    log_change = np.log([o.change_grey for o in observations])
    usual_mm = np.exp(_DEPTH_OF_CHANGE[0] + _DEPTH_OF_CHANGE[1] * log_change) * skin_scale(geometry)
    factor = float(np.median(usual_mm / np.array([o.depth_mm for o in observations])))
    if factor < _UNIT_FACTOR:
        return ""
    unit = min(_UNITS, key=lambda name: abs(math.log(_UNITS[name] / factor)))
    shown = f"the images show presses about {factor:.0f} times as deep as stated"
    return f"PRESSES.csv: depth_mm: {shown}: are the depths in {unit}?"


def axes_hint(observations: Sequence[PressObservation], geometry: Geometry) -> str:
    """A hint at other axes, or another unit of the places, that fit clearly better; empty if none do."""
    stated = with_stated_place(observations)
    if len(stated) < _AXES_LEAST_PRESSES:
        return ""

    as_stated = _error_mm(stated)
    best = min(_AXES, key=lambda name: _error_mm(stated, _AXES[name]))
    error = _error_mm(stated, _AXES[best])
    if error > _AXES_PART * as_stated or as_stated < _AXES_LEAST_MM * skin_scale(geometry):
        return ""
    return f"PRESSES.csv: x_mm, y_mm: the places fit within {error:.1f} mm, not {as_stated:.1f} mm, if {best}"


def _error_mm(stated: Sequence[PressObservation], axes: tuple[float, float, float, float] = (1, 0, 0, 1)) -> float:
    """Median distance of the located places from the stated ones as read by other axes, mm."""
    a, b, c, d = axes
    places = [(a * o.place_mm[0] + b * o.place_mm[1], c * o.place_mm[0] + d * o.place_mm[1]) for o in stated]
    return float(np.median([o.place_error_mm(*place) for o, place in zip(stated, places, strict=True)]))
