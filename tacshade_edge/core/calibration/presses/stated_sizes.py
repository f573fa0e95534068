"""Check the stated sizes of depths, balls and skin by a learned profile, without a refit.

A network is off on a sensor by a nearly constant factor (`gain`), so the greatest height that it finds shows a wrong
unit, and the fall of the height around that, at any factor, shows the radius of a ball.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.observation.press_observation import PressObservation
from tacshade_edge.core.calibration.presses.press_view import PressView
from tacshade_edge.types import F64, Geometry

# With fewer presses, or a network that sees a smaller part of them, nothing follows for the table.
_LEAST_PRESSES, _LEAST_SEEN_PART = 4, 0.5
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
    if len(balls) >= _LEAST_PRESSES and np.ptp(stated_mm) > 0:
        slope = theil_sen_slope(stated_mm, factors * stated_mm)
    return ShownSizes(_median(depths), _median(factors), slope)


def theil_sen_slope(x: F64, y: F64) -> float:
    """The Theil-Sen slope of y over x, (N,), N at least 2, not all x equal (H. Theil, "A rank-invariant method of
    linear and polynomial regression analysis", 1950).
    """
    i, j = np.triu_indices(len(x), 1)
    apart = x[i] != x[j]
    return float(np.median((y[j] - y[i])[apart] / (x[j] - x[i])[apart]))


def unit_mistake(shown: ShownSizes) -> str:
    """A message about a wrong unit of the depths; empty if the unit is right."""
    if not shown.depth > _UNIT_FACTOR:
        return ""
    unit = min(_UNITS, key=lambda name: abs(math.log(_UNITS[name] / shown.depth)))
    return (
        f"PRESSES.csv: depth_mm: the images show presses about {shown.depth:.0f} times as deep as stated: "
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
    if len(balls) < _LEAST_PRESSES:
        return math.nan
    stated = np.array([o.place_mm for o in balls])
    shown = np.array([(o.located_x_mm, o.located_y_mm) for o in balls])
    squares = float((stated * stated).sum())
    if squares < len(stated) * (_LEAST_REACH_RADII * skin_radius_mm) ** 2:
        return math.nan
    return float((shown * stated).sum() / squares)


def _median(values: Sequence[float] | F64) -> float:
    return float(np.median(values)) if len(values) >= _LEAST_PRESSES else math.nan


def _beyond(value: float, bounds: tuple[float, float]) -> bool:
    return value < bounds[0] or value > bounds[1]
