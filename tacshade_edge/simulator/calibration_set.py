"""Choose the ball presses that calibrate a sensor: spread over its visible disc, in radius and in depth."""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press

_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


def ball_presses(model: SensorModel, count: int, seed: int = 0) -> list[tuple[Press, float]]:
    """Draw ball presses and the radius of each ball in mm: places on a sunflower over the inner two thirds of the
    visible disc; radii (3 to 9 mm) and depths (0.5 to 4 mm) stratified, then shuffled, so that any subset covers their
    ranges. All lengths are for a skin of 20 mm and scale with its radius.
    """
    rng = np.random.default_rng((seed, 4))
    scale = model.skin_radius_mm / 20
    reach = 0.66 * model.skin_radius_mm * math.sin(math.radians(model.visible_half_angle_deg))

    def stratified(low: float, high: float) -> list[float]:
        cells = (rng.permutation(count) + rng.uniform(0, 1, count)) / max(count, 1)
        return [round(float(low + (high - low) * c) * scale, 3) for c in cells]

    presses = []
    for k, (radius, depth) in enumerate(zip(stratified(3.0, 9.0), stratified(0.5, 4.0), strict=True)):
        rho, angle = reach * math.sqrt((k + 0.5) / count), k * _GOLDEN_ANGLE
        x, y = round(rho * math.cos(angle), 3), round(rho * math.sin(angle), 3)
        presses.append((Press(ball(radius), x, y, depth), radius))
    return presses
