"""Measure the serial channel: binary poses through a pty, all accounted for, and garbage.

::

    .venv/bin/python -m tools.benchmarks.serial_line [--seconds 60] [--rate 1000] [--garbage 1000000] [--line usb]
    .venv/bin/python -m tools.benchmarks.serial_line --touch 60

The robot (`testbed.robot`) runs in its own process; this one has the daemon's thread, link and clock, without camera
and broker. Meanwhile it looks up the pose of 10 ms ago 30 times a second, as a frame would. Then the given number of
bytes of garbage goes through the link in pieces of random sizes.

With ``--touch`` six quantities of 60 frames a second go to a robot that reads at once, for the given seconds: the bench
reports the time from the end of a reconstruction until the robot has read the whole line.
"""

from __future__ import annotations

import argparse
import json
import os
import pty
import random
import select
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

from tacshade_edge.daemon.pipeline.observer import FrameResult
from tacshade_edge.daemon.robot.robot import Robot
from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.protocol.serial.line import seal
from tacshade_edge.protocol.serial.link import SerialLink
from tacshade_edge.protocol.serial.verbs import Command
from tacshade_edge.types import QUANTITIES, Frame, HeightMap, ObjectCloud, Reconstruction, Touch

FRAME_PERIOD_S = 1 / 30
BEHIND_NS = 10_000_000


def poses(seconds: float, rate_hz: float, line: str | None) -> None:
    """Print how many poses were sent and how many of them arrived."""
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
    """Print how the link counted random bytes, as lines and as frames."""
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


def touches(seconds: float) -> None:
    """Print how long touches took to reach a robot that listens."""
    master, slave = pty.openpty()
    robot = Robot(SerialPort(os.ttyname(slave), 115200), lambda _: None, dict, lambda _: None, lambda: None)
    robot.start()
    stream = os.fdopen(master, "r+b", buffering=0)
    stop = threading.Event()
    while b"READY" not in stream.read(4096):
        stop.wait(0.01)
    stream.write(seal(f"TOUCH ON {' '.join(QUANTITIES[:6])}"))
    while not robot.need():
        stop.wait(0.01)
    shown_ns: dict[int, int] = {}
    told = threading.Thread(target=_show_touches, args=(robot, shown_ns, seconds, stop))
    took_ms = []
    told.start()
    buffer = b""
    while told.is_alive() or select.select([stream], [], [], 0.5)[0]:
        if not select.select([stream], [], [], 0.1)[0]:
            continue
        buffer += stream.read(4096) or b""
        *lines, buffer = buffer.split(b"\n")
        now_ns = time.monotonic_ns()
        took_ms += [1e-6 * (now_ns - shown_ns[int(line.split()[2])]) for line in lines if line.startswith(b"EVT TOUCH")]
    robot.stop(2)
    counts = robot.health()
    took_ms.sort()
    quantiles = ", ".join(f"{q:g} % {took_ms[int(len(took_ms) * q / 100)]:.2f} ms" for q in (50, 90, 99))
    print(f"{len(shown_ns)} frames in contact, {len(took_ms)} events read, {counts['touch_dropped']} dropped, ", end="")
    print(f"{len(shown_ns) - len(took_ms) - counts['touch_dropped']} too soon after another; ", end="")
    print(f"from reconstruction to the robot: {quantiles}, most {took_ms[-1]:.2f} ms")
    stream.close()
    os.close(slave)


def _show_touches(robot: Robot, shown_ns: dict[int, int], seconds: float, stop: threading.Event) -> None:
    """Show frames in contact, 60 a second, as the reconstruct thread does."""
    image = np.zeros((2, 2), np.uint8)
    height = HeightMap(np.zeros((1, 1), np.float32), np.ones((1, 1), np.bool_), 0, 0, 1)
    cloud = ObjectCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16))
    touch = Touch(dict.fromkeys(QUANTITIES, -12.345))
    began_s = time.monotonic()
    for seq in range(int(60 * seconds)):
        stop.wait(max(0.0, began_s + seq / 60 - time.monotonic()))
        shown_ns[seq] = time.monotonic_ns()
        made = Reconstruction(
            *(seq, shown_ns[seq], 0, "fast", True, None, True, False, None), height, cloud, touch=touch
        )
        robot.see(FrameResult(Frame(seq, shown_ns[seq], 0, image), None, made))


def main() -> None:
    """Measure poses and garbage, or touches."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--rate", type=float, default=1000)
    parser.add_argument("--garbage", type=int, default=1_000_000)
    parser.add_argument("--line", choices=("usb", "loaded", "ftdi"))
    parser.add_argument("--touch", type=float, metavar="SECONDS")
    args = parser.parse_args()
    if args.touch:
        touches(args.touch)
        return
    poses(args.seconds, args.rate, args.line)
    garbage(args.garbage)


if __name__ == "__main__":
    main()
