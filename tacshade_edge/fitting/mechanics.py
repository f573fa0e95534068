"""What presses show of a skin's mechanics: simulate the balls with several skins and compare the pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np

from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.image import greyscale
from tacshade_edge.fitting.identify import Found, TwinRenderer, WhiteMap, print_of
from tacshade_edge.fitting.skins import Unevenness, uneven_skin
from tacshade_edge.simulator.press import Press, ball
from tacshade_edge.simulator.skin import undeformed
from tacshade_edge.types import F32, Calibration

LEAST_PRESSES, MOST_PRESSES = 5, 8
DECAYS_MM, FRICTIONS = (1.3, 1.7, 2.2, 2.9, 3.8), (0.6, 0.8, 1.0)
SMOOTH_CELLS = 2.0
LIKELY = 1.1
"""Mechanics that leave at most this many times the best ones' error unexplained are likely."""
STEP, FRICTION_STEP = 1.15, 0.1
"""Half the distance between neighbours of `DECAYS_MM` (a ratio) and of `FRICTIONS`, which ranges include."""


@dataclass(frozen=True, slots=True)
class Mechanics:
    """Ranges of a skin's decay length and friction."""

    decay_mm: tuple[float, float] = (1.3, 3.8)
    friction: tuple[float, float] = (0.6, 1.0)
    seen: bool = False


def likely_mechanics(calibration: Calibration, found: Found, presses: Sequence[KnownPress]) -> Mechanics:
    """The mechanics with which simulated balls look like the pressed ones; the full ranges without enough of them."""
    balls = [p for p in presses if p.indenter is None and p.x_mm is not None and p.y_mm is not None]
    if len(balls) < LEAST_PRESSES:
        return Mechanics()
    balls.sort(key=lambda press: press.depth_mm)
    balls = [balls[int(k)] for k in np.linspace(0, len(balls) - 1, min(len(balls), MOST_PRESSES)).round()]
    white = WhiteMap(calibration)
    at_rest = white.reference()
    seen = [_soft(white.of(greyscale.to_grey(press.image)) - at_rest) for press in balls]
    model, layout = found.at(found.values)
    errors = {}
    for decay_mm, friction in product(DECAYS_MM, FRICTIONS):
        skin_model = replace(model, skin_decay_mm=decay_mm, friction=friction)
        renderer = TwinRenderer(skin_model, found.kind, print_of(skin_model, found.kind, layout), found.light)

        def drawn(skin, renderer=renderer) -> F32:  # type: ignore[no-untyped-def]
            return white.of(np.clip(renderer.draw(skin) + 0.5, 0, 255).astype(np.uint8))

        free, off = drawn(undeformed(model.skin_radius_mm)), 0.0
        for press, change in zip(balls, seen, strict=True):
            pressed = Press(ball(press.radius_mm), press.x_mm or 0.0, press.y_mm or 0.0, press.depth_mm)
            made = _soft(drawn(uneven_skin(skin_model, (pressed,), Unevenness())) - free)
            off += float(np.square((made - change)[white.inside]).mean())
        errors[decay_mm, friction] = off
    best = min(errors.values())
    decays, frictions = zip(*(each for each, off in errors.items() if off <= LIKELY * best), strict=True)
    return Mechanics(
        (min(decays) / STEP, max(decays) * STEP),
        (min(frictions) - FRICTION_STEP, min(max(frictions) + FRICTION_STEP, 1.0)),
        seen=True,
    )


def _soft(cells: F32) -> F32:
    return np.asarray(cv2.GaussianBlur(cells, (0, 0), SMOOTH_CELLS), np.float32)
