"""The presses that a user of the study of fits takes: indenters, places and stated values."""

from __future__ import annotations

import numpy as np

from tacshade_edge.calibration import indenters as shapes
from tacshade_edge.calibration.indenters import Indenter
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.lab.simulator.press import OBJECTS, Press, Shape, ball, ridge
from tacshade_edge.lab.studies.evaluate.work import PRESS_NOISE, PressedSensor
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.types import F64
from tools.studies.command import stated_press

PRESSES = 40
PRESSED_MM = (0.6, 4.5)
"""Least and greatest depth of the presses, mm."""
CYLINDER_MM = 5.0
"""Radius of the simulator's cylinder."""


def lying(radius_mm: float, length_mm: float) -> Shape:
    """A cylinder along x with flat ends."""

    def sdf(p: F64) -> F64:
        along = np.abs(p[:, 0]) - length_mm / 2
        across = np.hypot(p[:, 1], p[:, 2] - radius_mm) - radius_mm
        return np.minimum(np.maximum(along, across), 0) + np.hypot(
            np.maximum(along, 0), np.maximum(across, 0)
        )

    return Shape("bar", sdf)


def indenters(scale: float, *, balls: bool) -> list[tuple[Shape, float, float, Indenter | None]]:
    """Each indenter's shape, scale, and the ball's radius in mm or the user's description."""
    made: list[tuple[Shape, float, float, Indenter | None]] = [
        (ball(radius * scale), 1.0, radius * scale, None) for radius in (3.0, 4.5, 7.0)
    ]
    if balls:
        return made
    for radius in (2.5 * scale, 4.0 * scale):
        flat = shapes.cylinder(f"flat {2 * radius:.1f}", radius)
        made.append((OBJECTS["cylinder"](), radius / CYLINDER_MM, 0.0, flat))
    side, radius, length = 6 * scale, 2 * scale, 12 * scale
    made.append((ridge(side, side), 1.0, 0.0, shapes.box("square", side, side)))
    made.append((lying(radius, length), 1.0, 0.0, shapes.bar("bar", radius, length)))
    return made


def pressed(sensor: PressedSensor, seed: int, *, balls: bool) -> list[KnownPress]:
    """The presses with the values that a user states."""
    rng, model = np.random.default_rng((seed, 77)), sensor.model
    scale = skin_scale(model.geometry)
    kinds = indenters(scale, balls=balls)
    reach_mm = 0.6 * model.skin_radius_mm * np.sin(np.radians(model.visible_half_angle_deg))
    made = []
    for k in range(PRESSES):
        shape, enlarged, radius_mm, known = kinds[k % len(kinds)]
        rho, angle, yaw = (
            reach_mm * np.sqrt(rng.random()),
            rng.uniform(0, 2 * np.pi),
            rng.uniform(0, 180),
        )
        x, y, depth = rho * np.cos(angle), rho * np.sin(angle), rng.uniform(*PRESSED_MM)
        press = Press(shape, x, y, depth, yaw, enlarged)
        image = sensor.frame((press,), PRESS_NOISE + k).image
        made.append(stated_press(rng, f"press {k}", image, press, radius_mm, known))
    return made
