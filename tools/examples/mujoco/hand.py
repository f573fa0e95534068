"""A sensor on a hand that a program moves, in a MuJoCo model with whatever it touches."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

import tacshade_edge as ts
from tacshade_edge.rigid import Rigid, from_seven, shift, turn
from tacshade_edge.types import F64

DOWN = from_seven((0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0))
"""The sensor looks down: its y and z are turned over."""


class Hand:
    """Adds the sensor of an MJCF file to a scene; the tip is moved, and nothing moves it."""

    def __init__(self, scene: Any, sensor_xml: str) -> None:
        hand = scene.worldbody.add_body(name="hand")
        hand.add_freejoint()
        child = mujoco.MjSpec.from_file(sensor_xml)
        scene.attach(child, prefix="hand/", frame=hand.add_frame())
        self.model = scene.compile()
        self.data = mujoco.MjData(self.model)
        self.sensor = ts.MujocoSensor(self.model, self.data, "hand/tacshade")
        self._to_tip = shift(0, 0, self.sensor.geometry.apex_z_mm)

    @property
    def tip(self) -> Rigid:
        """The tip's pose in the world."""
        return self._pose @ self._to_tip

    def put(self, x_mm: float, y_mm: float, z_mm: float) -> None:
        """Put the tip at a place, looking down, and begin anew."""
        mujoco.mj_resetData(self.model, self.data)
        self._place(shift(x_mm, y_mm, z_mm) @ DOWN)

    def move(self, velocity: F64, for_s: float) -> None:
        """Move the tip for a time by a velocity (6,) along and about the sensor's axes, in mm/s
        and °/s.
        """
        moved = shift(*(for_s * velocity[:3])) @ turn(np.radians(for_s * velocity[3:]))
        self.data.time += for_s
        self._place(self.tip @ moved)

    def _place(self, tip: Rigid) -> None:
        pose = tip @ self._to_tip.inverse()
        at = pose.seven()
        # Through the quaternion, since rounding must not add up.
        self._pose = Rigid(from_seven(at).rotation, pose.translation_mm)
        self.data.qpos[:3], self.data.qpos[3:] = np.array(at[:3]) / 1e3, at[3:]
        mujoco.mj_forward(self.model, self.data)
