"""Tables of balls whose depths are right, and what a network that is off finds of them."""

from __future__ import annotations

import numpy as np

from tacshade_edge.calibration.indenters import Ball, stated_ball
from tacshade_edge.lab.simulator.script import ball_presses
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.types import Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))
_SENSOR = SensorModel()


def right_depths(count: int, seed: int) -> tuple[list[float], list[Ball]]:
    """What a network that is off by 7 % and 0.15 mm finds of balls."""
    rng = np.random.default_rng(seed)
    balls = [
        stated_ball(20.0, p.x_mm, p.y_mm, p.depth_mm, radius)
        for p, radius in ball_presses(_SENSOR, count, seed)
    ]
    return [0.93 * b.depth_max_mm(20.0) + 0.15 * float(rng.standard_normal()) for b in balls], balls


def as_travel(found_mm: list[float], balls: list[Ball]) -> tuple[list[float], list[Ball]]:
    """The same presses, of which a table states the travel from first touch."""
    stated = [ball.deeper(-ball.first_touch_mm(20.0)) for ball in balls]
    kept = [k for k, ball in enumerate(stated) if ball.depth_max_mm(20.0) > 0]
    return [found_mm[k] for k in kept], [stated[k] for k in kept]
