#!/usr/bin/env python3
"""A simulated robot that moves a sensor over a curved surface, in real time: the sensor's messages
go to a broker, and the robot takes velocities by UDP, as `tools.examples.servo` sends them.

::

    .venv/bin/tacshade-edge simulate --mjcf mjcf
    .venv/bin/python -m tools.examples.mujoco.serve mjcf/sensor.xml localhost:1883 left-index
    .venv/bin/python -m tools.examples.servo.follow_surface localhost:1883 left-index
        --robot 127.0.0.1:30000
"""

from __future__ import annotations

import argparse
import socket
import time

import mujoco
import numpy as np

import tacshade_edge as ts
from tacshade_edge.rigid import Rigid, from_seven, shift, turn
from tacshade_edge.types import F64

RATE_HZ, STOP_S = 60, 0.1
HILL_MM, BEGIN_DEPTH_MM = 150.0, 1.0
_DOWN = from_seven((0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0))


class Robot:
    """A sensor above a lying cylinder of radius `HILL_MM` whose axis is y; its tip moves at the
    velocities that it is given, along and about the sensor's axes.
    """

    def __init__(self, sensor_xml: str) -> None:
        spec = mujoco.MjSpec()
        hill = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER)
        hill.size, hill.quat = (HILL_MM / 1e3, 0.1, 0), (1, 1, 0, 0)
        hand = spec.worldbody.add_body(name="hand")
        hand.add_freejoint()
        spec.attach(mujoco.MjSpec.from_file(sensor_xml), prefix="hand/", frame=hand.add_frame())
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self.sensor = ts.MujocoSensor(self._model, self._data, "hand/tacshade")
        self.tip_mm = self.sensor.geometry.apex_z_mm
        self.pose = shift(0, 0, HILL_MM + self.tip_mm - BEGIN_DEPTH_MM) @ _DOWN
        self.move(np.zeros(6), 0.0)

    @property
    def depth_mm(self) -> float:
        """How deep the hill lies in the undeformed skin."""
        x_mm, _, z_mm = self.pose.translation_mm
        return float(HILL_MM + self.tip_mm - np.hypot(x_mm, z_mm))

    def move(self, velocity: F64, for_s: float) -> None:
        """Move for a time with a velocity (6,) in mm/s and °/s."""
        moved, turned = shift(*(for_s * velocity[:3])), turn(np.radians(for_s * velocity[3:]))
        to_tip = shift(0, 0, self.tip_mm)
        self.pose = self.pose @ to_tip @ moved @ turned @ to_tip.inverse()
        # Rounding must not add up.
        self.pose = Rigid(from_seven(self.pose.seven()).rotation, self.pose.translation_mm)
        at = self.pose.seven()
        self._data.qpos[:3], self._data.qpos[3:] = np.array(at[:3]) / 1e3, at[3:]
        self._data.time += for_s
        mujoco.mj_forward(self._model, self._data)


def serve(robot: Robot, stream: ts.MujocoStream, port: int, seconds: float) -> None:
    """Take velocities and publish, in real time; the robot stands still without them."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", port))
        line.settimeout(0)
        velocity, heard_s = np.zeros(6), 0.0
        begun_s = now_s = time.monotonic()
        while now_s - begun_s < seconds:
            try:
                while words := line.recv(256).split():
                    velocity, heard_s = np.array([float(word) for word in words]), now_s
            except BlockingIOError:
                pass
            last_s, now_s = now_s, time.monotonic()
            robot.move(velocity if now_s - heard_s < STOP_S else np.zeros(6), now_s - last_s)
            stream.send()
            time.sleep(max(0.0, now_s + 1 / RATE_HZ - time.monotonic()))


def main() -> None:
    """Serve until Ctrl-C."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sensor_xml")
    parser.add_argument("broker", help="HOST or HOST:PORT")
    parser.add_argument("sensor", help="its sensor_id")
    parser.add_argument("--robot-port", type=int, default=30000)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    args = parser.parse_args()
    robot = Robot(args.sensor_xml)
    try:
        with ts.MujocoStream(robot.sensor, args.broker, args.sensor) as stream:
            serve(robot, stream, args.robot_port, args.seconds)
    except KeyboardInterrupt:
        pass
    print(f"moved {robot.pose.translation_mm[0]:.1f} mm along x, {robot.depth_mm:.2f} mm deep now")


if __name__ == "__main__":
    main()
