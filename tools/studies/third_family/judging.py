"""What the third family shows as strangers (../strangers):
Table I's objects, dragged, and presses of balls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.studies.evaluate.work import PRESS_NOISE
from tools.studies.command import stated_press
from tools.studies.third_family.domes import (
    FIRST_SEED,
    KINDS,
    REACH_RADII,
    SHALLOWEST_MM,
    SIZES_MM,
    Dome,
    Kept,
    Way,
    deepest_mm,
    deformed,
    drawn,
    kept_file,
    renderer,
)
from tools.studies.third_family.table_i import table_i_ways

DRAGGED, BALL = "dragged", "ball"
"""Name the files of these states."""
DRAG_MM = 2.0
"""Length of a drag on a skin of 20 mm."""
NEAREST, FARTHEST = 0.05, 0.25
"""Distance from the tip where a drag begins, in skin radii."""
BALLS_MM = tuple(size_mm for name, size_mm in KINDS if name == "ball")


def dragged_ways(dome: Dome, seed: int) -> list[Way]:
    """Press each object beside the middle as deep as `table_i_ways`, then drag it."""
    scale = dome.radius_mm / 20
    rng, made = np.random.default_rng((seed, 47)), []
    for way in table_i_ways(dome):
        rho = dome.radius_mm * rng.uniform(NEAREST, FARTHEST)
        at, along = rng.uniform(0, 2 * math.pi, 2)
        x_mm, y_mm = rho * math.cos(at), rho * math.sin(at)
        lowest = replace(way.press, x_mm=x_mm, y_mm=y_mm).lowest_z_mm(dome.radius_mm)
        drag_x_mm, drag_y_mm = (DRAG_MM * scale * f(along) for f in (math.cos, math.sin))
        x_mm, y_mm = x_mm + drag_x_mm, y_mm + drag_y_mm
        end = replace(
            way.press,
            x_mm=x_mm,
            y_mm=y_mm,
            # The object's height stays, so its depth below the skin at the end is another.
            depth_mm=math.sqrt(dome.radius_mm**2 - x_mm**2 - y_mm**2) - lowest,
            rotation_deg=float(rng.uniform(0, 360)),
            drag_x_mm=drag_x_mm,
            drag_y_mm=drag_y_mm,
        )
        made.append(Way(way.object_name, end))
    return made


def ball_ways(dome: Dome, seed: int, count: int) -> list[Way]:
    """Draw presses of balls, as `domes.known_ways` draws those of all kinds."""
    rng, scale, made = np.random.default_rng((seed, 46)), dome.radius_mm / 20, []
    for k in range(count):
        size_mm = BALLS_MM[k % len(BALLS_MM)]
        rho = REACH_RADII * dome.radius_mm * math.sqrt(rng.random())
        angle = rng.uniform(0, 2 * math.pi)
        depth_mm, turn_deg = rng.uniform((SHALLOWEST_MM, 0), (deepest_mm(dome), 360))
        x_mm, y_mm = rho * math.cos(angle), rho * math.sin(angle)
        enlarged = scale * size_mm / SIZES_MM["ball"]
        press = Press(OBJECTS["ball"](), x_mm, y_mm, depth_mm * scale, turn_deg, enlarged)
        made.append(Way("ball", press))
    return made


def known_balls(range_name: str, sensor: int, count: int, folder: Path) -> Sequence[KnownPress]:
    """State a sensor's stored presses of balls, with errors. Raises FileNotFoundError."""
    model, dome = drawn(range_name, sensor)
    seed = FIRST_SEED[range_name] + sensor
    draws, rng, made = renderer(model, seed), np.random.default_rng((seed, 48)), []
    for k, way in enumerate(ball_ways(dome, seed, count)):
        kept = Kept.read(kept_file(folder, range_name, sensor, BALL, k))
        skin = deformed(dome.radius_mm, kept.rest_mm, kept.pressed_mm)
        image = draws.expose(draws.draw(skin), PRESS_NOISE + k)
        radius_mm = SIZES_MM["ball"] * way.press.scale
        made.append(stated_press(rng, f"press {k}", image, way.press, radius_mm, None))
    return made
