#!/usr/bin/env python3
"""Compare the CPU time of a frame with that of another checkout of the project,
in alternating rounds on one thread.

::

    git worktree add /tmp/before c16ef09
    .venv/bin/python -m tools.benchmarks.against /tmp/before
        [--rounds 20] [--frames 60] [--objects cube,ring]

The frames are 640x480 colour images of the simulated sensor, untouched and under a cube that covers
a fifth of the disc, or under the named objects by turns, enlarged as much; each checkout makes its
own calibration. ``contact`` computes depth and cloud, ``shear`` adds shear, and ``everything`` adds
the errors of depth and encodes all payloads except the touch, which older checkouts lack. Each
figure is the median over rounds of a round's median (p50) or 99th percentile (p99); the ratio is
the median of the rounds' ratios. Other work on the machine lengthens CPU time little.
"""

from __future__ import annotations

import argparse
import importlib
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
KINDS = ("no contact", "contact", "shear", "everything")
NOISES = 8
NO_ANSWER = "none"

PLACES = {
    "SensorName": ("lab.studies.evaluate.work", "studies.evaluate.sensors"),
    "calibrated": ("lab.studies.evaluate.work", "studies.evaluate.sensors"),
    "reconstructor": ("lab.studies.evaluate.work", "studies.evaluate.sensors"),
    "OBJECTS": ("lab.simulator.press", "simulator.objects"),
    "Press": ("lab.simulator.press", "simulator.press"),
    "encode_height": ("wire.binary", "protocol.wire"),
    "encode_cloud": ("wire.binary", "protocol.wire"),
    "encode_shear": ("wire.binary", "protocol.wire"),
    "encode_sigma": ("wire.binary", "protocol.wire"),
    "encode_contact": ("wire.messages", "protocol.messages"),
}
"""Where a name stands in this checkout, and where it stood before the rooms by subject."""


def _from_checkout(name: str) -> Any:
    """What the imported checkout calls by this name, wherever it stands there."""
    for place in PLACES[name]:
        try:
            return getattr(importlib.import_module(f"tacshade_edge.{place}"), name)
        except ModuleNotFoundError:
            continue
    raise SystemExit(f"{name}: this checkout has it in none of {', '.join(PLACES[name])}")


def serve(frames: int, objects: Sequence[str]) -> None:
    """Time frames of the imported checkout, one measurement for each line on stdin."""
    import cv2

    from tacshade_edge import types

    cv2.setNumThreads(1)
    name = _from_checkout("SensorName").parse("default")
    calibration, sensor = _from_checkout("calibrated")(name, 8, 40).calibration, name.make()
    reconstructor, shapes = _from_checkout("reconstructor"), _from_checkout("OBJECTS")
    press_of, encode_contact = _from_checkout("Press"), _from_checkout("encode_contact")
    encoders = [_from_checkout(f"encode_{one}") for one in ("height", "cloud", "shear", "sigma")]
    presses = [press_of(shapes[one](), 0.0, 0.0, 3.0, 20.0, 1.45) for one in objects]
    images = {
        "no contact": [sensor.frame((), 4000 + k).image for k in range(NOISES)],
        "contact": [
            sensor.frame((press,), 3000 + k).image for press in presses for k in range(NOISES)
        ],
    }
    needs = getattr(types, "Need", None)
    made: dict[str, Any] = {}
    t_ns = 0
    print("ready", flush=True)
    for line in sys.stdin:
        profile, kind = line.strip().split("/")
        each = made.setdefault(profile, None) or reconstructor(calibration, profile)
        made[profile] = each
        shown = images["no contact" if kind == "no contact" else "contact"]
        if kind in ("shear", "everything") and needs is None:
            print(NO_ANSWER, flush=True)
            continue
        asked: dict[str, Any] = {} if needs is None else {"need": needs.DEPTH}
        if needs is not None and kind in ("shear", "everything"):
            asked = {"need": needs.SHEAR if kind == "shear" else needs.SHEAR | needs.SIGMA}
        taken = np.empty(frames)
        for k in range(-3, frames):
            t_ns += 16_666_667
            frame = types.Frame(0, t_ns, 0, shown[k % len(shown)])
            start = time.process_time_ns()
            found = each.step(frame, **asked)
            if kind == "everything":
                for encode in encoders:
                    encode(found, calibration_crc32=0)
                encode_contact(found, fps=60.0)
            if k >= 0:
                taken[k] = (time.process_time_ns() - start) / 1e6
        print(np.median(taken), np.percentile(taken, 99), flush=True)


class Checkout:
    """A process that times the frames of one checkout."""

    def __init__(self, root: Path, frames: int, objects: str) -> None:
        command = [sys.executable, __file__, str(root), "--serve", "--frames", str(frames)]
        command += ["--objects", objects]
        environment = os.environ | {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        if self._answer() != "ready":
            raise SystemExit(f"{root}: its code cannot be timed")

    def time_ms(self, profile: str, kind: str) -> tuple[float, float] | None:
        """p50 and p99 in ms; None if the checkout does not have this profile or kind."""
        assert self._process.stdin
        self._process.stdin.write(f"{profile}/{kind}\n")
        self._process.stdin.flush()
        answer = self._answer()
        if answer == NO_ANSWER:
            return None
        p50, p99 = map(float, answer.split())
        return p50, p99

    def _answer(self) -> str:
        assert self._process.stdout
        return self._process.stdout.readline().strip()


def main() -> None:
    """Time both checkouts and print the comparison."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkout", type=Path)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--frames", type=int, default=60, help="of a round")
    parser.add_argument("--objects", default="cube", metavar="NAME,...")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        serve(args.frames, args.objects.split(","))
        return
    from tacshade_edge.lab.studies.markdown import markdown
    from tacshade_edge.sensor.profiles import PROFILES

    now, before = (Checkout(root, args.frames, args.objects) for root in (ROOT, args.checkout))
    lines = []
    for profile in (name for name in PROFILES if name != "paper"):
        for kind in KINDS:
            rows = [
                (now.time_ms(profile, kind), before.time_ms(profile, kind))
                for _ in range(args.rounds)
            ]
            mine = np.array([row[0] for row in rows])
            cells = [f"{np.median(mine[:, k]):.2f}" for k in (0, 1)]
            if rows[0][1] is None:
                cells += ["", "", ""]
            else:
                other = np.array([row[1] for row in rows])
                cells += [f"{np.median(other[:, k]):.2f}" for k in (0, 1)]
                cells.append(f"{np.median(mine[:, 0] / other[:, 0]):.2f}")
            lines.append([profile, kind, *cells])
    print(
        markdown(
            ["method", "frame", "p50 ms", "p99 ms", "before: p50 ms", "p99 ms", "ratio"], lines
        )
    )


if __name__ == "__main__":
    main()
