"""Which key of SENSOR.yaml is wrong? Presses of known balls show it, by a profile likelihood: for each value of a key,
the balls' surfaces are compared with the heights that a network sees, up to one factor. The skin's radius and the half
angle act alike, so that both may explain the presses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tacshade_edge.core.calibration.indenters import ball_height_along, stated_ball
from tacshade_edge.core.calibration.observation import PressObservation
from tacshade_edge.core.depth.learned import scale_mm
from tacshade_edge.types import Geometry

_KEYS = ("camera_distance_mm", "visible_half_angle_deg", "skin_radius_mm")
_FACTORS = np.exp(np.linspace(-math.log(3), math.log(3), 17))
_MOST_DEG = 85.0
# A key explains the presses if its log likelihood exceeds that of the stated values by this much for each press and in
# all, and by this part of what the best key gains. On four simulated sensors each press gained 0.01 without a mistake,
# up to 0.23 with all places 1 mm or all depths 0.4 mm off, and over 1.1 with a radius or half angle a fifth too small.
_GAIN_EACH, _LEAST_GAIN, _PART_OF_BEST = 0.3, 8.0, 0.7
# Beyond the best of them, presses are mistakes of their own.
_MOST_MISFIT, _PART_BELIEVED = 1.0, 0.9
# A usual distance in skin radii, to try around if none is stated.
_USUAL_DISTANCE = 0.7


def wrong_keys(observations: Sequence[PressObservation], geometry: Geometry) -> str:
    """The keys that explain the presses far better with another value, and that value; empty if none or any does."""
    balls = [o for o in observations if o.is_seen and o.x_mm is not None and not o.indenter]
    if not balls:
        return ""
    stated, found = _misfit(balls, geometry, geometry), {}
    for key in _KEYS:
        now = getattr(geometry, key) or _USUAL_DISTANCE * geometry.skin_radius_mm
        tried = [
            float(now * factor)
            for factor in _FACTORS
            if key != _KEYS[1] or now * factor < _MOST_DEG
        ]
        others: list[dict[str, Any]] = [{key: value} for value in tried]
        misfits = [_misfit(balls, geometry, replace(geometry, **other)) for other in others]
        best = int(np.argmin(misfits))
        found[key] = len(balls) * math.log(stated / misfits[best]), tried[best]
    least = max(
        _GAIN_EACH * len(balls),
        _LEAST_GAIN,
        _PART_OF_BEST * max(gain for gain, _ in found.values()),
    )
    named = sorted(
        ((gain, key, at) for key, (gain, at) in found.items() if gain >= least), reverse=True
    )
    if len(named) == len(_KEYS):
        return ""
    stated_as = {key: getattr(geometry, key) for key in _KEYS}
    words = [
        f"{key}: found {stated_as[key] or 'none'}, expected about {at:.0f} by the presses"
        for _, key, at in named
    ]
    return f"SENSOR.yaml: {'; or '.join(words)}" if words else ""


def _misfit(balls: Sequence[PressObservation], stated: Geometry, tried: Geometry) -> float:
    """Mean part of the best balls' squared heights that the network's do not explain, at the median factor."""
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
    factor = np.median(both / of_seen)
    rest = (factor**2 * of_seen - 2 * factor * both + of_known) / of_known
    best = np.sort(np.minimum(rest, _MOST_MISFIT))[: math.ceil(_PART_BELIEVED * len(rest))]
    return float(best.mean())
