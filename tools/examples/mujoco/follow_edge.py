#!/usr/bin/env python3
"""Follow the edge of a disc by touch: an environment with Gymnasium's methods, and a controller.

::

    .venv/bin/tacshade-edge simulate --mjcf mjcf
    .venv/bin/python -m tools.examples.mujoco.follow_edge mjcf/sensor.xml
"""

from __future__ import annotations

import math
import sys
from typing import Any

import mujoco
import numpy as np

import tacshade_edge as ts
from tacshade_edge.types import F64

DISC_MM, TIP_MM, DT_S = 40.0, 20.0, 0.02
DEPTH_MM, INSIDE_MM = 1.5, 2.5  # of the tip; of the contact's middle from the edge


class FollowEdge:
    """Observation: the greatest depth in mm, y in mm of the contact's middle, and the direction in
    degrees of its long axis from x. Action: vx, vy, vz in mm/s and wz in °/s, of the sensor.
    """

    def __init__(self, sensor_xml: str) -> None:
        spec = mujoco.MjSpec()
        disc = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER)
        disc.size, disc.pos = (DISC_MM / 1e3, 0.005, 0), (0, 0, -0.005)
        hand = spec.worldbody.add_body(name="hand")
        hand.add_freejoint()
        spec.attach(mujoco.MjSpec.from_file(sensor_xml), prefix="hand/", frame=hand.add_frame())
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._sensor = ts.MujocoSensor(self._model, self._data, "hand/tacshade")
        self._place = np.zeros(4)  # x, y, z in mm and the turn about z, of the sensor

    def reset(self, *, seed: int | None = None) -> tuple[F64, dict[str, Any]]:
        """Begin within a millimetre of the disc's edge."""
        beside_mm = float(np.random.default_rng(seed).uniform(-1, 1))
        self._place[:] = 0, DISC_MM + beside_mm, TIP_MM - DEPTH_MM, 0
        mujoco.mj_resetData(self._model, self._data)
        return self._felt(), {}

    def step(self, action: F64) -> tuple[F64, float, bool, bool, dict[str, Any]]:
        """Move for `DT_S`; the reward is higher the nearer the tip is to the edge."""
        along, across, down, about = DT_S * np.asarray(action)
        turned = self._place[3]
        # The sensor looks down: its y and z are turned over.
        self._place[0] += along * math.cos(turned) + across * math.sin(turned)
        self._place[1] += along * math.sin(turned) - across * math.cos(turned)
        self._place[2:] -= down, math.radians(about)
        self._data.time += DT_S
        felt, beside_mm = self._felt(), math.hypot(*self._place[:2]) - DISC_MM
        return felt, -abs(beside_mm), not felt.any(), False, {"beside_mm": beside_mm}

    def _felt(self) -> F64:
        half = self._place[3] / 2
        self._data.qpos[:3] = self._place[:3] / 1e3
        self._data.qpos[3:] = 0, math.cos(half), math.sin(half), 0
        mujoco.mj_forward(self._model, self._data)
        result = self._sensor.read(shear=False)
        if not result.in_contact:
            return np.zeros(3)
        x_y_mm = result.points_mm[:, :2]
        x, y = np.linalg.eigh(np.cov(x_y_mm.T))[1][:, 1]
        return np.array((result.depth_max_mm, x_y_mm[:, 1].mean(), math.degrees(math.atan(y / x))))


def velocity(felt: F64, speed_mm_s: float = 20.0) -> F64:
    """Move along the edge, and keep depth, place and direction."""
    depth_mm, y_mm, edge_deg = felt
    return np.array((speed_mm_s, 4 * (y_mm - INSIDE_MM), 4 * (DEPTH_MM - depth_mm), 4 * edge_deg))


def main() -> int:
    """Go around the disc once."""
    world = FollowEdge(sys.argv[1])
    felt, off_mm = world.reset()[0], []
    for _ in range(round(2 * math.pi * DISC_MM / 20 / DT_S)):
        felt, _, lost, _, info = world.step(velocity(felt))
        off_mm.append(abs(info["beside_mm"]))
        if lost:
            break
    print(
        f"{len(off_mm)} steps; {np.mean(off_mm):.2f} mm from the edge, {max(off_mm):.2f} at worst"
    )
    return int(lost)


if __name__ == "__main__":
    sys.exit(main())
