"""Detect mistakes in a whole table of presses: sizes of depths, balls and skin; axes, units, polarity; zero of the
depths.

A network is off on a sensor that it never saw by a nearly constant factor (`refit`). So the greatest height that it
finds shows a wrong unit, the fall of the height around that, at any factor, shows the radius of a ball, and its depths
against the true ones lie on a line through 0: if the stated ones lie on another line, their zero is not the one that
docs/reference/calibration-files.md defines. Depths stated as travel from first touch are off by an amount that grows
with the distance from the middle; the share of that amount in the error, 0 or 1, is a third coefficient. Shallow
presses decide, since the error of a depth grows with it. (The weights: P. J. Huber, "Robust estimation of a location
parameter", Ann. Math. Stat. 35, 1964.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.indenters import Placed
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.observation import PressObservation, with_stated_place
from tacshade_edge.core.calibration.presses.press_check import PressView
from tacshade_edge.core.geometry.disc_map import skin_scale
from tacshade_edge.types import F64, Geometry, Polarity

# With fewer presses, or a network that sees a smaller part of them, nothing follows for the table.
_LEAST_SIZED, _LEAST_SEEN_PART = 4, 0.5
# Median ratio of shown to stated over all presses. Good tables: depths 0.6 to 1.3, balls 0.79 to 1.6 (0.79 on a stiff
# skin over soft gel), places 0.95 to 1.05. Diameters: balls 0.40 to 0.63.
_UNIT_FACTOR = 4.0
_UNITS = {"cm": 10.0, "inches": 25.4, "m": 1000.0}
_BALL_FACTORS = (0.7, 1.85)
# If all stated depths are too great by a constant, balls look smaller, most of all at shallow presses, and depths as
# much. Without that (slope), balls are 0.79 or more in good tables, 0.67 or less for diameters. Balls over depths are
# 0.96 or more for depths 0.7 or 1 mm too great, 0.58 or less for diameters.
_LEAST_BALL_SLOPE, _LEAST_BALL_PER_DEPTH = 0.9, 0.9
_PLACE_FACTORS = (0.6, 1.4)
# Places nearer to the middle than this (RMS, skin radii) show no factor: a place is found within 1 mm.
_LEAST_REACH_RADII = 0.1
# Without places: if twice the skin's radius is stated, balls look three or more times as large, and depths larger too.
_SKIN_BALL_FACTORS, _SKIN_DEPTH_FACTORS = (0.45, 2.5), (0.8, 1.3)
# log(depth) of any sensor from log χ alone, on the nominal skin: coarse, but enough to detect a wrong unit.
_DEPTH_OF_CHANGE = -1.61, 1.3
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
# An offset counts if it exceeds these mm on the nominal skin and standard deviations, and the line's slope is one that
# the network has on known kinds of sensors. Good tables have 0.26 mm at most. tools/studies/calibration.py measures
# what this finds, rightly and wrongly.
_LEAST_OFFSET_MM, _OFFSET_DEVIATIONS, _SLOPES = 0.3, 3.0, (0.85, 1.15)
# A coefficient above the first value, and this many standard deviations, is a hint that depths are travel from first
# touch; above the third and fourth the table is rejected.
_HINTED_TRAVEL, _HINTED_DEVIATIONS, _SURE_TRAVEL, _SURE_DEVIATIONS = 0.65, 3.0, 0.7, 4.0
# Error of a depth: a part of it, and mm on the nominal skin; and the least deviation relative to that.
_ERROR_PART, _ERROR_MM, _LEAST_DEVIATION = 0.12, 0.15, 0.3
_HUBER, _ITERATIONS = 1.5, 25
# Fewer presses show too little; with fewer than the second, nothing is certain.
_LEAST_ZEROED, _LEAST_SURE = 12, 16
TRAVEL_ADVICE = (
    "pass --depth-from-touch, or state the undeformed skin's z at (x, y) minus the z of the indenter's "
    "lowest point (docs/reference/calibration-files.md)"
)


@dataclass(frozen=True, slots=True)
class ShownSizes:
    """Median ratio of shown to stated sizes over all presses, NaN if too few show it: of depths, of balls' radii, and
    of radii despite a constant offset of all depths: the image shows radius times depth, so that is the slope of that
    over the stated depth (NaN if the depths are equal).
    """

    depth: float
    ball: float
    ball_slope: float


def shown_sizes(presses: Sequence[KnownPress], views: Sequence[PressView | None]) -> ShownSizes:
    """Compare the sizes that a network sees with the stated ones."""
    seen = [(press, view) for press, view in zip(presses, views, strict=True) if view is not None]
    depths = [view.depth_mm / press.depth_mm for press, view in seen]
    balls = [(press.depth_mm, view.ball_factor) for press, view in seen if math.isfinite(view.ball_factor)]
    if len(seen) < _LEAST_SEEN_PART * len(presses):
        balls = []
    stated_mm, factors = np.array(balls).reshape(-1, 2).T
    slope = math.nan
    if len(balls) >= _LEAST_SIZED and np.ptp(stated_mm) > 0:
        slope = theil_sen_slope(stated_mm, factors * stated_mm)
    return ShownSizes(_median(depths), _median(factors), slope)


def theil_sen_slope(x: F64, y: F64) -> float:
    """The Theil-Sen slope of y over x, (N,), N at least 2, not all x equal (H. Theil, "A rank-invariant method of
    linear and polynomial regression analysis", 1950).
    """
    i, j = np.triu_indices(len(x), 1)
    apart = x[i] != x[j]
    return float(np.median((y[j] - y[i])[apart] / (x[j] - x[i])[apart]))


def unit_mistake(factor: float) -> str:
    """A message about a wrong unit of depths that images show as this much greater than stated; empty if right."""
    if not factor > _UNIT_FACTOR:
        return ""
    unit = min(_UNITS, key=lambda name: abs(math.log(_UNITS[name] / factor)))
    return (
        f"PRESSES.csv: depth_mm: the images show presses about {factor:.0f} times as deep as stated: "
        f"are the depths in {unit}? expected mm"
    )


def size_mistake(shown: ShownSizes, observations: Sequence[PressObservation], geometry: Geometry) -> str:
    """A message about a wrong size of the skin or of all balls; empty if both are right."""
    places = _place_factor(observations, geometry.skin_radius_mm)
    skin = math.nan
    if math.isfinite(places):
        skin = places if not _PLACE_FACTORS[0] < places < _PLACE_FACTORS[1] else math.nan
    elif _beyond(shown.ball, _SKIN_BALL_FACTORS) and _beyond(shown.depth, _SKIN_DEPTH_FACTORS):
        skin = math.sqrt(shown.ball * shown.depth)
    if math.isfinite(skin):
        radius_mm = geometry.skin_radius_mm
        asked = "a diameter" if skin > 1 else "half of the radius"
        return (
            f"SENSOR.yaml: skin_radius_mm: found {radius_mm:g}, but with it the images show presses about {skin:.1f} "
            f"times as large as PRESSES.csv: is it {asked}? expected about {radius_mm / skin:.0f}"
        )
    too_deep = shown.ball_slope > _LEAST_BALL_SLOPE or shown.ball > _LEAST_BALL_PER_DEPTH * shown.depth
    if _beyond(shown.ball, _BALL_FACTORS) and not (shown.ball < 1 and too_deep):
        asked = "are they diameters?" if shown.ball < 1 else "are they halved?"
        return (
            f"PRESSES.csv: radius_mm: the images show balls of about {shown.ball:.1f} times the stated radii: "
            f"{asked} expected radii in mm"
        )
    return ""


def _place_factor(observations: Sequence[PressObservation], skin_radius_mm: float) -> float:
    """Ratio of the balls' shown to stated distances from the middle; NaN if too little is stated."""
    balls = [o for o in observations if o.x_mm is not None and not o.indenter]
    if len(balls) < _LEAST_SIZED:
        return math.nan
    stated = np.array([o.place_mm for o in balls])
    shown = np.array([(o.located_x_mm, o.located_y_mm) for o in balls])
    squares = float((stated * stated).sum())
    if squares < len(stated) * (_LEAST_REACH_RADII * skin_radius_mm) ** 2:
        return math.nan
    return float((shown * stated).sum() / squares)


def _median(values: Sequence[float] | F64) -> float:
    return float(np.median(values)) if len(values) >= _LEAST_SIZED else math.nan


def _beyond(value: float, bounds: tuple[float, float]) -> bool:
    return value < bounds[0] or value > bounds[1]


def table_hints(observations: Sequence[PressObservation], geometry: Geometry) -> tuple[str, ...]:
    """Hints at other readings of the whole table that fit clearly better than the stated one."""
    return tuple(hint for hint in (_unit_hint(observations, geometry), axes_hint(observations, geometry)) if hint)


def other_polarity(polarity: Polarity) -> Polarity:
    """The opposite."""
    return "dark" if polarity == "bright" else "bright"


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
        f"SENSOR.yaml: polarity: found {stated}, expected {other_polarity(stated)}: "
        f"the places fit within {else_error:.1f} mm with it, not {error:.1f} mm"
    )


def _unit_hint(observations: Sequence[PressObservation], geometry: Geometry) -> str:
    log_change = np.log([o.change_grey for o in observations])
    usual_mm = np.exp(_DEPTH_OF_CHANGE[0] + _DEPTH_OF_CHANGE[1] * log_change) * skin_scale(geometry)
    return unit_mistake(float(np.median(usual_mm / np.array([o.depth_mm for o in observations]))))


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


def zero_hint(found_mm: Sequence[float], placed: Sequence[Placed], geometry: Geometry) -> str:
    """A message about another zero of the depths that fits clearly better than the stated one, judging by the greatest
    h that a network finds in each press without a refit; empty if none does.
    """
    r, scale = geometry.skin_radius_mm, skin_scale(geometry)
    found = np.asarray(found_mm) / scale
    if len(found) < _LEAST_ZEROED or np.ptp(found) == 0:
        return ""
    stated = np.array([at.depth_max_mm(r) for at in placed]) / scale
    share, deviation = _travel_share(found, placed, geometry)
    if share > max(_HINTED_TRAVEL, _HINTED_DEVIATIONS * deviation):
        return f"the stated depths fit better as travel from first touch: {TRAVEL_ADVICE}"
    (slope, offset), (_, deviation) = _robust_fit(np.stack((found, np.ones_like(found)), axis=1), stated)
    beyond = abs(offset) > max(_LEAST_OFFSET_MM, _OFFSET_DEVIATIONS * deviation)
    if not (beyond and _SLOPES[0] < slope < _SLOPES[1]):
        return ""
    change = f"{abs(offset) * scale:.1f} mm {'less' if offset > 0 else 'more'}"
    return f"the depths fit better if all are {change}: check where depth is zero"


def travel_mistake(found_mm: Sequence[float], placed: Sequence[Placed], geometry: Geometry) -> str:
    """A message if the depths are certainly travel from first touch; empty otherwise. Takes what `zero_hint` takes."""
    found = np.asarray(found_mm) / skin_scale(geometry)
    if len(found) < _LEAST_SURE or np.ptp(found) == 0:
        return ""
    share, deviation = _travel_share(found, placed, geometry)
    if share < max(_SURE_TRAVEL, _SURE_DEVIATIONS * deviation):
        return ""
    return f"PRESSES.csv: depth_mm: found travel from first touch, judging by the images: {TRAVEL_ADVICE}"


def _travel_share(found: F64, placed: Sequence[Placed], geometry: Geometry) -> tuple[float, float]:
    """The share of travel from first touch in the stated depths, 0 to 1 plus noise, and its standard deviation."""
    r, scale = geometry.skin_radius_mm, skin_scale(geometry)
    stated = np.array([at.depth_max_mm(r) for at in placed]) / scale
    missing = stated - np.array([at.deeper(at.first_touch_mm(r)).depth_max_mm(r) for at in placed]) / scale
    x = np.stack((found, missing, np.ones_like(found)), axis=1)
    if np.linalg.matrix_rank(x) < x.shape[1]:
        return 0.0, math.inf
    coefficients, deviations = _robust_fit(x, stated)
    return float(coefficients[1]), float(deviations[1])


def _robust_fit(x: F64, stated: F64) -> tuple[F64, F64]:
    """Fit coefficients (C,) of the columns of x (N, C), first the network's depths, and their deviations (C,)."""
    trust = 1 / np.hypot(_ERROR_MM, _ERROR_PART * x[:, 0])
    weight = trust * trust
    for _ in range(_ITERATIONS):
        normal = x.T @ (x * weight[:, None])
        coefficients = np.linalg.solve(normal, x.T @ (weight * stated))
        error = np.abs(stated - x @ coefficients) * trust
        deviation = max(1.4826 * float(np.median(error)), _LEAST_DEVIATION)
        weight = trust * trust * np.minimum(1, _HUBER * deviation / np.maximum(error, 1e-9))
    free = len(x) / (len(x) - x.shape[1])
    deviations: F64 = deviation * np.sqrt(free * np.diag(np.linalg.inv(normal)))
    return np.asarray(coefficients, np.float64), deviations
