"""Which key of SENSOR.yaml is wrong?

Presses of known balls show it, by a profile likelihood: for each value of a key, the balls'
surfaces are compared with the heights that a network sees, up to one factor. The skin's radius and
the half angle act alike, so that both may explain the presses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tacshade_edge.calibration.findings import (
    BetterForm,
    BetterValue,
    CalibrationFinding,
    FindingCode,
    finding,
)
from tacshade_edge.calibration.indenters import ball_height_along, stated_ball
from tacshade_edge.calibration.observation import PressObservation
from tacshade_edge.sensor.depth.learned import scale_mm
from tacshade_edge.types import Geometry

_KEYS = ("camera_distance_mm", "visible_half_angle_deg", "skin_radius_mm")
_PAD_KEYS = ("camera_distance_mm", "pad_radius_mm")
_NAMES = {"pad_radius_mm": "visible_radius_mm"}
"""Fields of `Geometry` that have another name in SENSOR.yaml."""
_FACTORS = np.exp(np.linspace(-math.log(3), math.log(3), 17))
_MOST_DEG = 85.0
# A key explains the presses if its log likelihood exceeds that of the stated values by this much
# for each press and in all, and by this part of what the best key gains. On four simulated sensors
# each press gained 0.01 without a mistake, up to 0.23 with all places 1 mm or all depths 0.4 mm
# off, and over 1.1 with a radius or half angle a fifth too small.
_GAIN_EACH, _LEAST_GAIN, _PART_OF_BEST = 0.3, 8.0, 0.7
# Beyond the best of them, presses are mistakes of their own.
_MOST_MISFIT, _PART_BELIEVED = 1.0, 0.9
# A usual distance in skin radii, to try around if none is stated; and that of the lens from the
# visible circle, in its radii.
_USUAL_DISTANCE, _USUAL_LENS = 0.7, 1.75
# Half angles of the other forms that are tried (0:
# a pad), and factors on the lens's distance from the visible circle.
_HALF_ANGLES_DEG = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0)
# Of a dome's half angle: another radius with nearly the same angle explains what a wrong angle
# does.
_FLATTER = 0.5
# Forms whose misfits differ by this part explain the presses alike.
_ALIKE = 0.1
_LENS_FACTORS = np.exp(np.linspace(-math.log(2), math.log(2), 9))


def wrong_keys(
    observations: Sequence[PressObservation], geometry: Geometry
) -> CalibrationFinding | None:
    """The keys that explain the presses far better with another value, and that value, or another
    form of the skin that does better still; None if none does, or any key.
    """
    balls = [o for o in observations if o.is_seen and o.x_mm is not None and not o.indenter]
    if not balls:
        return None
    stated = _misfit(balls, geometry, geometry)
    found = {key: _best_value(balls, geometry, key, stated) for key in _keys(geometry)}
    best = max(gain for gain, _ in found.values())
    form_gain, form = _best_form(balls, geometry, stated)
    enough = max(_GAIN_EACH * len(balls), _LEAST_GAIN)
    least = max(enough, _PART_OF_BEST * max(best, form_gain))
    named: list[tuple[float, BetterValue | BetterForm]] = [
        (gain, BetterValue(_NAMES.get(key, key), getattr(geometry, key), at))
        for key, (gain, at) in found.items()
        if gain >= least
    ]
    if len(named) == len(found) and form_gain < best + enough:
        return None
    if form_gain >= least:
        named.append((form_gain, BetterForm(geometry, form)))
    if not named:
        return None
    likeliest_first = sorted(named, key=lambda each: each[0], reverse=True)
    return finding(FindingCode.WRONG_KEYS, better=[one for _, one in likeliest_first])


def _keys(geometry: Geometry) -> tuple[str, ...]:
    return _PAD_KEYS if geometry.skin == "pad" else _KEYS


def _best_value(
    balls: Sequence[PressObservation], geometry: Geometry, key: str, stated: float
) -> tuple[float, float]:
    """The log likelihood that the best value of a key gains over the `stated` misfit,
    and the value.
    """
    now = getattr(geometry, key) or _USUAL_DISTANCE * geometry.size_mm
    tried = [
        float(now * factor) for factor in _FACTORS if key != _KEYS[1] or now * factor < _MOST_DEG
    ]
    others: list[dict[str, Any]] = [{key: value} for value in tried]
    misfits = [_misfit(balls, geometry, replace(geometry, **other)) for other in others]
    best = int(np.argmin(misfits))
    return len(balls) * math.log(stated / misfits[best]), tried[best]


def _best_form(
    balls: Sequence[PressObservation], geometry: Geometry, stated: float
) -> tuple[float, Geometry]:
    """The gain of the best other form with the same visible circle, and that form, at the lens's
    distance nearest to the stated one of those that do about as well.
    """
    most_deg = _FLATTER * geometry.visible_half_angle_deg or _MOST_DEG
    halves = [half for half in _HALF_ANGLES_DEG if half <= most_deg]
    tried = [(half, factor) for half in halves for factor in _LENS_FACTORS.tolist()]
    forms = [_formed(geometry, *each) for each in tried]
    misfits = np.array([_misfit(balls, geometry, form) for form in forms])
    # Depth of the lens and form act alike; the stated lens is the better guess.
    near = np.flatnonzero(misfits <= misfits.min() * (1 + _ALIKE))
    best = min(near.tolist(), key=lambda k: (abs(math.log(tried[k][1])), misfits[k]))
    return len(balls) * math.log(stated / misfits[best]), forms[best]


def _formed(geometry: Geometry, half_angle_deg: float, factor: float) -> Geometry:
    """A skin with the visible circle of `geometry` and its own half angle (0: a pad), at a factor
    on the lens's distance from the circle.
    """
    radius_mm, d = geometry.visible_radius_mm, geometry.camera_distance_mm
    lens_mm = _USUAL_LENS * radius_mm
    if d is not None:
        lens_mm = geometry.f_px * geometry.mm_per_px
    half = math.radians(half_angle_deg)
    if not half:
        return Geometry(math.inf, factor * lens_mm, 0.0, geometry.disc, radius_mm)
    r = radius_mm / math.sin(half)
    return Geometry(r, factor * lens_mm - r * math.cos(half), half_angle_deg, geometry.disc)


def _misfit(balls: Sequence[PressObservation], stated: Geometry, tried: Geometry) -> float:
    """Mean part of the best balls' squared heights that the network's do not explain,
    at the median factor.
    """
    # The lens would lie before the visible circle.
    if tried.camera_distance_mm is not None and not tried.f_px > 0:
        return _MOST_MISFIT
    per_px = tried.mm_per_px if tried.camera_distance_mm is None else 1 / tried.f_px
    sums = []
    for o in balls:
        assert o.x_mm is not None
        assert o.y_mm is not None
        ball = stated_ball(tried.skin_radius_mm, o.x_mm, o.y_mm, o.depth_mm, o.radius_mm)
        x_px, y_px, height_mm = o.seen_cells
        known = np.maximum(
            np.nan_to_num(ball_height_along(tried, ball, x_px * per_px, y_px * per_px)), 0
        )
        seen = height_mm * float(scale_mm(tried) / scale_mm(stated))
        sums.append((seen @ known, seen @ seen, max(known @ known, 1e-9)))
    both, of_seen, of_known = np.array(sums).T
    # One factor for all: a network is off by one, and with one each a wrong key would hide.
    factor = np.median(both / of_seen)
    rest = (factor**2 * of_seen - 2 * factor * both + of_known) / of_known
    best = np.sort(np.minimum(rest, _MOST_MISFIT))[: math.ceil(_PART_BELIEVED * len(rest))]
    return float(best.mean())
