"""Three like fingers around the hand's y, which hold a ball."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np

from tacshade_edge.lab.simulator.press import Shape
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.simulated_hand import SimulatedFinger
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.rigid import Rigid, shift, turn

BALL_MM, DEPTH_MM = 40.0, 1.5
BALL = Shape("sphere", lambda p: np.asarray(np.linalg.norm(p, axis=1) - np.float32(BALL_MM)))
HOME = Rigid(np.eye(3), np.zeros(3))
MODEL = replace(
    SensorModel(),
    image_height_px=120,
    image_width_px=160,
    row_c=58.7,
    col_c=82.3,
    disc_radius_px=51.0,
    bulge=0.0,
)


def place(angle_deg: float, away_mm: float = BALL_MM + MODEL.skin_radius_mm - DEPTH_MM) -> Rigid:
    """``hand_T_sensor`` of a finger that looks at the hand's origin, from x towards z."""
    a = math.radians(angle_deg)
    looks = turn((0.0, math.atan2(-math.cos(a), -math.sin(a)), 0.0))
    return shift(away_mm * math.cos(a), 0.0, away_mm * math.sin(a)) @ looks


@cache
def three_fingers() -> tuple[SimulatedFinger, ...]:
    sensor = SimulatedSensor(MODEL)
    return tuple(SimulatedFinger(f"at {angle}", place(angle), sensor) for angle in (90, 210, 330))
