#!/usr/bin/env python3
"""A fake ``rpicam-vid`` that acts as a robot and shows what the simulated sensor sees at the
robot's pose.

Put a script named ``rpicam-vid`` that starts this program on the daemon's PATH. `SERVO` in the
environment is a JSON object with the settings: `scene` (surface, edge), the robot's `delay_s`,
`port` (UDP, on loopback) for commands ``vx vy vz wx wy wz``, `kept` (the folder of tables), and
`log`, a CSV file for the true touch of each frame.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import sys
import threading
import time
from collections import deque
from pathlib import Path

import numpy as np

from tacshade_edge.lab.simulator.render import Renderer
from tacshade_edge.types import F64
from tools.testbed.servo.skins import MODEL
from tools.testbed.servo.world import LateRobot, scene


def main() -> int:
    """Write frames until the reader closes the pipe."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--width", type=int)
    parser.add_argument("--height", type=int)
    parser.add_argument("--framerate", type=float)
    parser.add_argument("--metadata")
    parser.add_argument("--shutter", type=float)
    parser.add_argument("--gain", type=float)
    args, _ = parser.parse_known_args()
    if (args.width, args.height) != (MODEL.image_width_px, MODEL.image_height_px):
        print(
            f"ERROR: found {args.width}x{args.height}, expected the simulated sensor's size",
            file=sys.stderr,
        )
        return 255
    scenario = json.loads(os.environ["SERVO"])
    place, draws = scene(scenario["scene"], Path(scenario["kept"])), Renderer(MODEL)
    colour = bytes([128]) * (args.width * args.height // 2)
    heard: deque[tuple[float, F64]] = deque()
    with (
        Path(args.metadata).open("wb", buffering=0) as records,
        Path(scenario["log"]).open("w", buffering=1) as log,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line,
    ):
        line.bind(("127.0.0.1", scenario["port"]))
        threading.Thread(target=_hear, args=(line, heard), daemon=True).start()
        period_s, began_s, n, last = 1 / args.framerate, time.monotonic(), 0, -1
        robot = LateRobot(place.start, scenario["delay_s"], began_s)
        print("t_ns,lost", *place.touch(robot.pose), "x_mm", sep=",", file=log)
        while True:
            n = max(
                n + 1, int((time.monotonic() - began_s) / period_s)
            )  # the frames in between are lost
            at_s = began_s + n * period_s
            time.sleep(max(0.0, at_s - time.monotonic()))
            while heard:
                robot.hear(*heard.popleft())
            robot.go_on(at_s)
            touch = place.touch(robot.pose)
            image = draws.expose(draws.draw(place.skin(touch)), n)[..., 1]
            sys.stdout.buffer.write(image.tobytes() + colour)
            sys.stdout.buffer.flush()
            record = {
                "SensorTimestamp": round(at_s * 1e9),
                "ExposureTime": round(args.shutter),
                "AnalogueGain": args.gain,
                "FrameDuration": round(period_s * 1e6),
            }
            records.write(
                "".join(f"{key}={value}\n" for key, value in record.items()).encode() + b"\n"
            )
            numbers = (*touch.values(), float(robot.pose.translation_mm[0]))
            print(
                record["SensorTimestamp"],
                n - last - 1,
                *(f"{v:.4f}" for v in numbers),
                sep=",",
                file=log,
            )
            last = n


def _hear(line: socket.socket, heard: deque[tuple[float, F64]]) -> None:
    while True:
        words = line.recv(256)
        heard.append((time.monotonic(), np.array(words.split(), float)))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except BrokenPipeError:
        os._exit(255)
