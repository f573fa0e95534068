"""Measure the serial channel: binary poses through a pty, all accounted for, and garbage.

::

    .venv/bin/python -m tools.benchmarks.serial_line [--seconds 60] [--rate 1000] [--garbage 1000000] [--line usb]

The robot (`testbed.robot`) is a process of its own; here are the daemon's thread, link and clock, without camera and
broker. While it runs, the pose of 10 ms ago is asked for 30 times a second, as a frame would. Then as many bytes of
garbage go through the link, in pieces of random sizes.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

from tacshade_edge.daemon.robot.robot import Robot
from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.protocol.serial.line import seal
from tacshade_edge.protocol.serial.link import SerialLink
from tacshade_edge.protocol.serial.verbs import Command

FRAME_PERIOD_S = 1 / 30
BEHIND_NS = 10_000_000


def poses(seconds: float, rate_hz: float, line: str | None) -> None:
    """Print what was sent and what became of it."""
    link = Path(f"/dev/shm/tacshade-bench-{os.getpid()}")
    command = [sys.executable, "-m", "tools.testbed.robot", "--link", str(link), "--binary"]
    command += ["--rate", str(rate_hz), "--seconds", str(seconds), *(["--line", line] if line else [])]
    robot = Robot(SerialPort(str(link), 115200), lambda _: None, dict, lambda _: None, lambda: None)
    pause = threading.Event()
    asked = known = 0
    error_us: list[int] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        robot.start()
        while not robot.health()["poses"] and process.poll() is None:
            pause.wait(0.01)
        began_s, cpu_s = time.monotonic(), time.process_time()
        while process.poll() is None:
            found = robot.motion.at(time.monotonic_ns() - BEHIND_NS)
            asked += 1
            known += found is not None
            error_us += [found[1]] if found else []
            pause.wait(FRAME_PERIOD_S)
        cpu = (time.process_time() - cpu_s) / (time.monotonic() - began_s)
        assert process.stdout is not None
        told = json.loads(process.stdout.read())
    robot.stop(2)
    counts = robot.health()
    at_the_end = told["poses"] - counts["poses"] - counts["poses_lost"]
    print(f"sent {told['poses']} poses, arrived {counts['poses']}, missing by number {counts['poses_lost']}, ", end="")
    print(f"at the end {at_the_end}; damaged {counts['damaged']}, garbage {counts['garbage']}")
    print(f"exchanges {counts['exchanges']} of {told['syncs']}, restarts of the clock {counts['clock_restarts'] - 1}")
    print(f"pose known for {known} of {asked} frames; median error {sorted(error_us)[len(error_us) // 2]} us")
    print(f"CPU {100 * cpu:.1f} % of a core")


def garbage(size: int) -> None:
    """Print what a link made of random bytes, as lines and as frames."""
    rng = random.Random(1)
    for binary in (False, True):
        link = SerialLink()
        link.receive(seal("#1 HELLO 1 crc=req") + (seal("#2 MODE BIN") if binary else b""), 0)
        data = rng.randbytes(size)
        at, done, said = 0, 0, 0
        began_s = time.perf_counter()
        while at < size:
            step = rng.randrange(1, 400)
            done += sum(isinstance(event, Command) for event in link.receive(data[at : at + step], at))
            said += len(link.take_output())
            at += step
        took_s = time.perf_counter() - began_s
        link.receive(b"\0\n" + seal("#1 HELLO 1 crc=req boot=2"), size)
        heard = [type(event).__name__ for event in link.receive(seal("#2 CAPTURE"), size)]
        print(
            f"{size} bytes of garbage in {'BIN' if binary else 'ASCII'}: {done} commands, {link.counts.poses} poses, "
            f"{said} bytes said, {1e6 * took_s / size:.2f} s per MB; then CAPTURE is heard as {heard}"
        )


def main() -> None:
    """Both."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--rate", type=float, default=1000)
    parser.add_argument("--garbage", type=int, default=1_000_000)
    parser.add_argument("--line", choices=("usb", "loaded", "ftdi"))
    args = parser.parse_args()
    poses(args.seconds, args.rate, args.line)
    garbage(args.garbage)


if __name__ == "__main__":
    main()
