"""Honest tables of poses with what their presses show, on wavy surfaces, of sensors of any size."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.types import F64


@dataclass(frozen=True, slots=True, eq=False)
class PressedTable:
    """Presses (x, y, z in mm in the sensor frame, weight), and the poses that a robot reported."""

    size_mm: float
    presses: list[F64]
    base_T_flange: list[Rigid]
    flange_T_sensor: Rigid


def pressed_table(
    seed: int, *, size_mm: float, relief: float = 0.08, noise: float = 0.0, presses: int = 36
) -> PressedTable:
    """A scan of a grid whose presses overlap: `relief` is the surface's amplitude in parts of the
    size, `noise` that of the robot in mm and degrees.
    """
    draw = np.random.default_rng(seed)
    waves = draw.uniform(-1, 1, (6, 2)) * 6 / size_mm
    phases = draw.uniform(0, 2 * math.pi, 6)

    def height(x: F64, y: F64) -> F64:
        at = x[:, None] * waves[:, 0] + y[:, None] * waves[:, 1] + phases
        return np.asarray(relief * size_mm * np.sin(at).mean(axis=1) * 2)

    flange_T_sensor = shift(*draw.uniform(-50, 50, 3)) @ turn(draw.uniform(-1, 1, 3))
    base = shift(*draw.uniform(-400, 400, 3)) @ turn((0.0, 0.0, draw.uniform(-3, 3)))
    reach, side = 0.35 * size_mm, math.ceil(math.sqrt(presses))
    step = draw.uniform(0.6, 1.1) * reach
    made, poses = [], []
    for k in range(presses):
        x, y = step * (k % side), step * (k // side)
        z = float(height(np.array([x]), np.array([y]))[0])
        tilt = turn((*np.radians(draw.uniform(-3, 3, 2)), draw.uniform(-0.5, 0.5)))
        facing = turn((math.pi, 0.0, 0.0)) @ tilt
        # The apex, which is `size_mm` from the sensor's origin, lies a little below the surface.
        depth_mm = draw.uniform(0.02, 0.08) * size_mm
        origin = np.array((x, y, z - depth_mm)) - facing.rotation @ (0.0, 0.0, size_mm)
        map_T_sensor = Rigid(facing.rotation, origin)
        angle, far = draw.uniform(0, 2 * math.pi, 120), reach * np.sqrt(draw.uniform(0, 1, 120))
        px, py = x + far * np.cos(angle), y + far * np.sin(angle)
        error = draw.normal(0, 0.003 * size_mm, 120) + draw.normal(0, 0.004 * size_mm)
        points = np.stack((px, py, height(px, py) + error), axis=1)
        seen = map_T_sensor.inverse().apply(points)
        made.append(np.column_stack((seen, draw.uniform(0.3, 1, 120))))
        robot = shift(*draw.normal(0, noise, 3)) @ turn(np.radians(draw.normal(0, noise, 3)))
        pose = base @ map_T_sensor
        about = Rigid(pose.rotation, pose.translation_mm)
        wrong = Rigid(robot.rotation @ about.rotation, about.translation_mm + robot.translation_mm)
        poses.append(wrong @ flange_T_sensor.inverse())
    return PressedTable(size_mm, made, poses, flange_T_sensor)
