"""Detect mistakes in a whole table of presses: sizes of depths, balls and skin; axes, units,
polarity; zero of the depths. A network is off on a sensor that it never saw by a nearly constant
factor (`refit`). So the greatest height that it finds shows a wrong unit, the fall of the height
around that the radius of a ball, and its depths against the true ones lie on a line through 0: if
the stated ones lie on another line, their zero is another. Travel from first touch is off by an
amount that grows with the distance from the middle; its share in the error, 0 or 1, is a third
coefficient. (The weights: P. J. Huber, Ann. Math. Stat. 35, 1964.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tacshade_edge.calibration.findings import (
    Axes,
    CalibrationFinding,
    FindingCode,
    SizeMistake,
    finding,
)
from tacshade_edge.calibration.indenters import Placed
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.observation import PressObservation, with_stated_place
from tacshade_edge.calibration.presses.row_check import order_hint
from tacshade_edge.calibration.sentences import FindingError
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.types import F64, Geometry, Polarity

# With fewer presses, or a network that sees a smaller part of them, nothing follows for the table.
_LEAST_SIZED, _LEAST_SEEN_PART = 4, 0.5
# Median ratio of shown to stated over all presses. Good tables: depths 0.6 to 1.3, balls 0.79 to
# 1.6 (0.79 on a stiff skin over soft gel), places 0.95 to 1.05. Diameters: balls 0.40 to 0.63.
_UNIT_FACTOR = 4.0
_UNITS = {"cm": 10.0, "inches": 25.4, "m": 1000.0}
_BALL_FACTORS = (0.7, 1.85)
# Balls whose radii differ by less show no spread. Of an infinite size, good ones would look 1.0,
# 1.1 and over 1.5 times as large on three oblate shells, and those of halved radii twice that.
_LEAST_SIZES, _SPREAD_BALL = 1.5, 1.5
# If all stated depths are too great by a constant, balls look smaller, and depths as much. Balls
# over depths are 0.96 or more for depths 0.7 or 1 mm too great, 0.58 or less for diameters.
_LEAST_BALL_PER_DEPTH = 0.9
_PLACE_FACTORS = (0.6, 1.4)
# Places nearer to the middle than this (RMS, skin radii) show no factor:
# a place is found within 1 mm.
_LEAST_REACH_RADII = 0.1
# Without places: if twice the skin's radius is stated, balls look three or more times as large,
# and depths larger too.
_SKIN_BALL_FACTORS, _SKIN_DEPTH_FACTORS = (0.45, 2.5), (0.8, 1.3)
_SKIN_MISTAKES = {SizeMistake.DIAMETER: 2.0, SizeMistake.HALF: 0.5, SizeMistake.CM: 0.1}
# Suggest other axes if they leave less than this part of an error
# of at least this many mm on the nominal skin.
_AXES_PART, _AXES_LEAST_MM = 0.5, 1.75
_AXES_LEAST_PRESSES = 4
# Suggest the other polarity if it leaves less than the first part of an error that is at least the
# second part of the presses' distance from the middle.
_POLARITY_PART, _POLARITY_LEAST_PART = 0.6, 0.25
Linear = tuple[float, float, float, float]
"""Another reading of x and y, (a, b, c, d): x is a·x + b·y, y is c·x + d·y."""
_AXES: Mapping[Axes, Linear] = {
    Axes.SWAPPED: (0, 1, 1, 0),
    Axes.X_OPPOSITE: (-1, 0, 0, 1),
    Axes.Y_OPPOSITE: (1, 0, 0, -1),
    Axes.BOTH_OPPOSITE: (-1, 0, 0, -1),
    Axes.SWAPPED_OPPOSITE: (0, -1, -1, 0),
    Axes.TURNED_LEFT: (0, -1, 1, 0),
    Axes.TURNED_RIGHT: (0, 1, -1, 0),
    Axes.CM: (10, 0, 0, 10),
    Axes.INCHES: (25.4, 0, 0, 25.4),
    Axes.METRES: (1000, 0, 0, 1000),
    Axes.MICROMETRES: (1e-3, 0, 0, 1e-3),
}
# An offset counts if it exceeds these mm on the nominal skin and standard deviations, and the
# line's slope is one that the network has on known kinds of sensors. Good tables have 0.26 mm at
# most. tools/studies/calibration.py measures what this finds, rightly and wrongly.
_LEAST_OFFSET_MM, _OFFSET_DEVIATIONS, _SLOPES = 0.3, 3.0, (0.85, 1.15)
# Depths are travel from first touch if its coefficient exceeds this, and so many standard
# deviations. Of right tables, this refuses one in 20,000 (tools/studies/travel.py).
_TRAVEL, _TRAVEL_DEVIATIONS = 0.8, 3.5
# Error of a depth: a part of it, and mm on the nominal skin;
# and the least deviation relative to that.
_ERROR_PART, _ERROR_MM, _LEAST_DEVIATION = 0.12, 0.15, 0.3
_HUBER, _ITERATIONS = 1.5, 25
# Fewer presses show too little; with fewer than the second, no travel.
_LEAST_ZEROED, _LEAST_TRAVELLED = 12, 16


def gross_mistakes(
    observations: Sequence[PressObservation],
    geometry: Geometry,
    presses: Sequence[KnownPress] = (),
) -> tuple[CalibrationFinding, ...]:
    """Mistakes that all presses share, or in the skin's size; of all presses of the table, some are
    observed.

    Only a network that sees the presses finds sizes.
    """
    seen = [o for o in observations if o.is_seen]
    depth = _median([o.seen_depth_mm / o.depth_mm for o in seen])
    is_mostly_seen = len(seen) >= _LEAST_SEEN_PART * len(observations)
    ball = _ball_factor([o for o in seen if is_mostly_seen and math.isfinite(o.ball_factor)])
    # Places are found without a network too, so axes are judged even if it sees nothing.
    axes = axes_hint(observations, geometry)
    # Values of other rows look like many other mistakes.
    turned = _AXES.get(Axes(str(axes.values["axes"]))) if axes else None
    if order := order_hint(presses, observations, geometry, turned):
        return (order,)
    mistakes = [unit_mistake(depth), axes]
    if seen and not any(mistakes):  # with a wrong unit or place, the other sizes mean nothing
        mistakes = [size_mistake(depth, ball, observations, geometry)]
    return tuple(mistake for mistake in mistakes if mistake)


def unit_mistake(factor: float) -> CalibrationFinding | None:
    """A wrong unit of depths that images show as this much greater than stated; None if right."""
    if not factor > _UNIT_FACTOR:
        return None
    unit = min(_UNITS, key=lambda name: abs(math.log(_UNITS[name] / factor)))
    return finding(FindingCode.DEPTH_UNIT, factor=factor, unit=unit)


def _ball_factor(balls: Sequence[PressObservation]) -> float:
    """The median ratio of shown to stated radii; of balls that look too large because the skin
    spreads every dent alike, that of a ball much larger than the spread.

    A shown radius is then the root of the squared radius and the squared spread: of small balls a
    multiple of the stated one. Halved radii show in balls of all sizes.
    """
    ratio = _median([o.ball_factor for o in balls])
    if not ratio > _BALL_FACTORS[1]:
        return ratio
    # A line through the medians of three groups by size, up to an infinite size.
    squares = np.array(sorted((o.radius_mm**-2, o.ball_factor**2) for o in balls))
    per_size, shown = np.array([np.median(group, axis=0) for group in np.array_split(squares, 3)]).T
    if per_size[-1] < _LEAST_SIZES**2 * per_size[0]:
        return ratio
    _, of_infinite = np.polyfit(per_size, shown, 1)
    return math.sqrt(max(of_infinite, 1.0)) if of_infinite < _SPREAD_BALL**2 else ratio


def size_mistake(
    depth: float, ball: float, observations: Sequence[PressObservation], geometry: Geometry
) -> CalibrationFinding | None:
    """A wrong size of the skin or of all balls, by median ratios of shown to stated depths
    and radii (NaN: unknown); None if both are right.
    """
    places = _place_factor(observations, geometry.size_mm)
    skin = math.nan
    if math.isfinite(places):
        skin = places if not _PLACE_FACTORS[0] < places < _PLACE_FACTORS[1] else math.nan
    elif _beyond(ball, _SKIN_BALL_FACTORS) and _beyond(depth, _SKIN_DEPTH_FACTORS):
        skin = math.sqrt(ball * depth)
    if math.isfinite(skin):
        key, radius_mm = "skin_radius_mm", geometry.skin_radius_mm
        if geometry.skin == "pad":
            key, radius_mm = "visible_radius_mm", geometry.visible_radius_mm
        likely = min(_SKIN_MISTAKES, key=lambda name: abs(math.log(_SKIN_MISTAKES[name] / skin)))
        return finding(
            FindingCode.SKIN_SIZE,
            key=key,
            found_mm=radius_mm,
            factor=skin,
            mistake=likely,
            expected_mm=radius_mm / _SKIN_MISTAKES[likely],
        )
    if _beyond(ball, _BALL_FACTORS) and not _LEAST_BALL_PER_DEPTH * depth < ball < 1:
        code = FindingCode.DIAMETERS if ball < 1 else FindingCode.HALVED_RADII
        return finding(code, factor=ball)
    return None


def _place_factor(observations: Sequence[PressObservation], size_mm: float) -> float:
    """Ratio of the balls' shown to stated distances from the middle;
    NaN if too little is stated.
    """
    balls = [o for o in observations if o.x_mm is not None and not o.indenter]
    if len(balls) < _LEAST_SIZED:
        return math.nan
    stated = np.array([o.place_mm for o in balls])
    shown = np.array([(o.located_x_mm, o.located_y_mm) for o in balls])
    # By least squares through 0: places near the middle, which show no factor, weigh little.
    squares = float((stated * stated).sum())
    if squares < len(stated) * (_LEAST_REACH_RADII * size_mm) ** 2:
        return math.nan
    factor = float((shown * stated).sum() / squares)
    # No size turns places to the other side of the middle.
    return factor if factor > 0 else math.nan


def _median(values: Sequence[float] | F64) -> float:
    return float(np.median(values)) if len(values) >= _LEAST_SIZED else math.nan


def _beyond(value: float, bounds: tuple[float, float]) -> bool:
    return value < bounds[0] or value > bounds[1]


def other_polarity(polarity: Polarity) -> Polarity:
    """The opposite."""
    return "dark" if polarity == "bright" else "bright"


def polarity_hint(
    observations: Sequence[PressObservation], other: Sequence[PressObservation], stated: Polarity
) -> CalibrationFinding | None:
    """A hint at the other polarity, if the places of the same presses then fit clearly better."""
    found, else_found = (with_stated_place(presses) for presses in (observations, other))
    if len(found) < _AXES_LEAST_PRESSES:
        return None
    error, else_error = _error_mm(found), _error_mm(else_found)
    reach = float(np.median([math.hypot(*o.place_mm) for o in found]))
    if else_error > _POLARITY_PART * error or error < _POLARITY_LEAST_PART * reach:
        return None
    if else_error > min(_error_mm(found, axes) for axes in _AXES.values()):
        return None  # other axes explain it better
    return finding(
        FindingCode.POLARITY,
        found=stated,
        expected=other_polarity(stated),
        found_mm=error,
        expected_mm=else_error,
    )


def axes_hint(
    observations: Sequence[PressObservation], geometry: Geometry
) -> CalibrationFinding | None:
    """A hint at other axes, or another unit of the places, that fit clearly better."""
    stated = with_stated_place(observations)
    if len(stated) < _AXES_LEAST_PRESSES:
        return None
    as_stated = _error_mm(stated)
    errors = {name: _error_mm(stated, axes) for name, axes in _AXES.items()}
    errors |= _pixel_errors_mm(stated, geometry)
    best = min(errors, key=lambda name: errors[name])
    error = errors[best]
    if error > _AXES_PART * as_stated or as_stated < _AXES_LEAST_MM * skin_scale(geometry):
        return None
    return finding(FindingCode.AXES, found_mm=as_stated, expected_mm=error, axes=best)


def _error_mm(stated: Sequence[PressObservation], axes: Linear = (1, 0, 0, 1)) -> float:
    """Median distance of the located places from the stated ones as read by other axes, mm."""
    a, b, c, d = axes
    places = [
        (a * o.place_mm[0] + b * o.place_mm[1], c * o.place_mm[0] + d * o.place_mm[1])
        for o in stated
    ]
    return float(
        np.median([o.place_error_mm(*place) for o, place in zip(stated, places, strict=True)])
    )


def _pixel_errors_mm(stated: Sequence[PressObservation], geometry: Geometry) -> dict[Axes, float]:
    """The same for places that are read as pixels of the image."""
    disc = geometry.disc
    origins = {
        Axes.PIXELS: (disc.col_c, disc.row_c, False),
        Axes.PIXELS_SWAPPED: (disc.col_c, disc.row_c, True),
        Axes.PIXELS_FROM_MIDDLE: (0.0, 0.0, False),
    }
    errors = {}
    for name, (col, row, swapped) in origins.items():
        apart = []
        for o in stated:
            mm = _mm_per_px(geometry, o)
            at_col, at_row = o.place_mm[::-1] if swapped else o.place_mm
            apart.append(o.place_error_mm((at_col - col) * mm, (at_row - row) * mm))
        errors[name] = float(np.median(apart))
    return errors


def _mm_per_px(geometry: Geometry, seen: PressObservation) -> float:
    """Size of a pixel on the undeformed skin where a press is located."""
    d = geometry.camera_distance_mm
    if d is None:
        return geometry.mm_per_px
    z_mm = geometry.apex_z_mm
    if geometry.skin == "dome":
        rho2 = seen.located_x_mm**2 + seen.located_y_mm**2
        z_mm = math.sqrt(max(geometry.skin_radius_mm**2 - rho2, 0.0))
    return (z_mm + d) / geometry.f_px


def zero_hint(
    found_mm: Sequence[float], placed: Sequence[Placed], geometry: Geometry
) -> CalibrationFinding | None:
    """A better zero of the stated depths, judging by the greatest h that a network finds in each
    press without a refit; None if none is clearly better.

    Raises FindingError if the depths are certainly travel from first touch.
    """
    r, scale = geometry.skin_radius_mm, skin_scale(geometry)
    found = np.asarray(found_mm) / scale
    if len(found) < _LEAST_ZEROED or np.ptp(found) == 0:
        return None
    stated = np.array([at.depth_max_mm(r) for at in placed]) / scale
    missing = (
        stated
        - np.array([at.deeper(at.first_touch_mm(r)).depth_max_mm(r) for at in placed]) / scale
    )
    x = np.stack((found, missing, np.ones_like(found)), axis=1)
    # Presses that all lie at the middle miss nothing: then the three columns depend on each other.
    if len(found) >= _LEAST_TRAVELLED and np.linalg.matrix_rank(x) == x.shape[1]:
        (_, share, _), (_, deviation, _), beyond = _robust_fit(x, stated)
        # With few presses, the median of the errors is small now and then by chance: then it
        # takes all errors.
        if share >= max(_TRAVEL, _TRAVEL_DEVIATIONS * deviation * max(1.0, beyond)):
            raise FindingError(finding(FindingCode.TRAVEL))
    (slope, offset), (_, deviation), _ = _robust_fit(x[:, [0, 2]], stated)
    is_beyond = abs(offset) > max(_LEAST_OFFSET_MM, _OFFSET_DEVIATIONS * deviation)
    if not (is_beyond and _SLOPES[0] < slope < _SLOPES[1]):
        return None
    code = FindingCode.DEPTHS_TOO_GREAT if offset > 0 else FindingCode.DEPTHS_TOO_SMALL
    return finding(code, by_mm=float(abs(offset) * scale))


def _robust_fit(x: F64, stated: F64) -> tuple[F64, F64, float]:
    """Fit coefficients (C,) of the columns of x (N, C), first the network's depths; also return
    their deviations (C,), by the median error, and the ratio of the RMS error to that.
    """
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
    spread = math.sqrt(float(error @ error) / (len(x) - x.shape[1])) / deviation
    return np.asarray(coefficients, np.float64), deviations, spread
