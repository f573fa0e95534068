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
from tools.examples.mujoco.hand import Hand

RATE_HZ, STOP_S = 60, 0.1
HILL_MM, BEGIN_DEPTH_MM = 150.0, 1.0


def above_a_hill(sensor_xml: str) -> Hand:
    """A sensor above a lying cylinder of radius `HILL_MM` whose axis is y."""
    scene = mujoco.MjSpec()
    hill = scene.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER)
    hill.size, hill.quat = (HILL_MM / 1e3, 0.1, 0), (1, 1, 0, 0)
    hand = Hand(scene, sensor_xml)
    hand.put(0, 0, HILL_MM - BEGIN_DEPTH_MM)
    return hand


def depth_mm(hand: Hand) -> float:
    """How deep the hill lies in the undeformed skin."""
    x_mm, _, z_mm = hand.tip.translation_mm
    return float(HILL_MM - np.hypot(x_mm, z_mm))


def serve(hand: Hand, stream: ts.MujocoStream, port: int, seconds: float) -> None:
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
            hand.move(velocity if now_s - heard_s < STOP_S else np.zeros(6), now_s - last_s)
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
    hand = above_a_hill(args.sensor_xml)
    try:
        with ts.MujocoStream(hand.sensor, args.broker, args.sensor) as stream:
            serve(hand, stream, args.robot_port, args.seconds)
    except KeyboardInterrupt:
        pass
    print(f"moved {hand.tip.translation_mm[0]:.1f} mm along x, {depth_mm(hand):.2f} mm deep now")


if __name__ == "__main__":
    main()
