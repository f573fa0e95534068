#!/usr/bin/env python3
"""Follow the edge of a disc by touch: an environment with Gymnasium's methods, and a controller.

::

    .venv/bin/tacshade-edge simulate --mjcf mjcf
    .venv/bin/python -m tools.examples.mujoco.follow_edge mjcf/sensor.xml
"""

import math
import sys
from typing import Any

import mujoco
import numpy as np

import tacshade_edge as ts
from tacshade_edge.types import F64
from tools.examples.mujoco.hand import Hand

DISC_MM, SPEED_MM_S, DT_S = 40.0, 20.0, 0.02
DEPTH_MM, INSIDE_MM = 1.5, 2.5  # of the tip; of the contact's middle from the edge


class FollowEdge:
    """Observation: the greatest depth in mm, y in mm of the contact's middle, and the direction in
    degrees of its long axis from x. Action: vx, vy, vz in mm/s and wz in °/s, of the sensor.
    """

    def __init__(self, sensor_xml: str) -> None:
        scene = mujoco.MjSpec()
        disc = scene.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER)
        disc.size, disc.pos = (DISC_MM / 1e3, 0.005, 0), (0, 0, -0.005)
        self.hand = Hand(scene, sensor_xml)

    def reset(self, *, seed: int | None = None) -> tuple[F64, dict[str, Any]]:
        """Begin within a millimetre of the disc's edge."""
        beside_mm = float(np.random.default_rng(seed).uniform(-1, 1))
        self.hand.put(0, DISC_MM + beside_mm, -DEPTH_MM)
        return felt(self.hand.sensor.read(shear=False)), {}

    def step(self, action: F64) -> tuple[F64, float, bool, bool, dict[str, Any]]:
        """Move for `DT_S`; the reward is higher the nearer the tip is to the edge."""
        self.hand.move(np.array((*action[:3], 0, 0, action[3])), DT_S)
        observed = felt(self.hand.sensor.read(shear=False))
        beside_mm = math.hypot(*self.hand.tip.translation_mm[:2]) - DISC_MM
        return observed, -abs(beside_mm), not observed.any(), False, {}


def felt(result: ts.Result) -> F64:
    """The observation, zero without contact."""
    if not result.in_contact:
        return np.zeros(3)
    x_y_mm = result.points_mm[:, :2]
    x, y = np.linalg.eigh(np.cov(x_y_mm.T))[1][:, 1]
    return np.array((result.depth_max_mm, x_y_mm[:, 1].mean(), math.degrees(math.atan(y / x))))


def velocity(observed: F64) -> F64:
    """Move along the edge, and keep depth, place and direction."""
    depth_mm, y_mm, edge_deg = observed
    return np.array((SPEED_MM_S, 4 * (y_mm - INSIDE_MM), 4 * (DEPTH_MM - depth_mm), 4 * edge_deg))


if __name__ == "__main__":
    world, off_mm = FollowEdge(sys.argv[1]), np.zeros(0)
    observed, lost = world.reset()[0], False
    while not lost and len(off_mm) < 2 * math.pi * DISC_MM / (SPEED_MM_S * DT_S):
        observed, reward, lost, *_ = world.step(velocity(observed))
        off_mm = np.append(off_mm, -reward)
    print(f"{len(off_mm)} steps: {off_mm.mean():.2f} mm from the edge, {off_mm.max():.2f} at worst")
