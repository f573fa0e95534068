#!/usr/bin/env python3
"""``make test-arm``: what runs on a board's processor, on QEMU's model of one,
for both Pythons of boards.

::

    python3 -m tools.ci.run_arm [--python 3.11 3.13] [--skip-quick | --count-only]

For each Python: the wheels of the lock, one frame after the other against this machine's, maps by
the command of its Debian package, the quick tests (half an hour each: nothing is emulated fast).
For one: the instructions of a frame, on each board's processor, and what they would take there.
Needs root; tools/rig/arm64.py says what else. Exit 1 when something failed.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from support.mqtt_rig import Broker
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.profiles import PROFILES
from tools.ci.arm_frames import COUNT, FREE, PRESSED, STAGES, stages_of
from tools.ci.run_tests import QUICK
from tools.rig.arm64 import PROCESSOR, instructions_between

TREE = Path(__file__).resolve().parents[2]
ARM = (sys.executable, "-m", "tools.rig.arm64")
GIVEN = Path(".rig/arm")  # below the tree, which is another folder there
PYTHONS = ("3.11", "3.13")
WORKERS = str(os.cpu_count() or 1)
HEIGHT_MAX_MM = {"paper": 0.01, "fast": 0.001, "balanced": 0.001, "accurate": 0.001}
"""Between the two machines, of any cell: white and codes are the same,
floats after them are not.
"""
WHITE_MAX_PART = 0.0
FRAMES = {"no contact": FREE, "contact": PRESSED}


@dataclass(frozen=True, slots=True)
class Board:
    """A board's processor, by QEMU's name; how many instructions of code like ours a core completes
    in a cycle, between a scalar loop that waits and vector code that does not.
    """

    name: str
    processor: str
    clock_hz: float
    least_per_cycle: float
    most_per_cycle: float

    def times_ms(self, instructions: float) -> str:
        """The time that they take, from its best to its worst."""
        best, worst = (
            1e3 * instructions / self.clock_hz / each
            for each in (self.most_per_cycle, self.least_per_cycle)
        )
        return f"{best:.1f} to {worst:.1f}"


BOARDS = (
    Board("Pi Zero 2 W (Cortex-A53, 1.0 GHz)", "cortex-a53", 1.0e9, 0.5, 1.0),
    Board("Pi 4 (Cortex-A72, 1.8 GHz)", "cortex-a72", 1.8e9, 0.8, 1.6),
    Board("Pi 5 (Cortex-A76, 2.4 GHz)", "cortex-a76", 2.4e9, 1.4, 2.8),
)


def arm(python: str, *command: str) -> int:
    """Run a command on the other machine; return its exit status."""
    return subprocess.run((*ARM, "--python", python, *command), cwd=TREE, check=False).returncode


def same_frames(python: str) -> list[str]:
    """Print the differences; return those beyond the stated bounds."""
    there, here = TREE / GIVEN / f"there-{python}.npz", TREE / GIVEN / "here.npz"
    if arm(
        python,
        "python3",
        "-m",
        "tools.ci.arm_frames",
        "reconstruct",
        str(GIVEN),
        str(GIVEN / there.name),
    ):
        return ["the frames could not be reconstructed there"]
    ours, theirs = np.load(here), np.load(there)
    wrong, rows = [], []
    if sorted(ours) != sorted(theirs):
        return ["other maps than here"]
    for profile in PROFILES:
        mine = [key for key in ours if key.startswith(f"{profile} ")]
        white = np.concatenate(
            [(ours[key] != theirs[key]).ravel() for key in mine if key.endswith("white")]
        ).mean()
        height, contact = [], []
        for key in mine:
            if key.endswith("height"):
                height.append(float(np.nanmax(np.abs(ours[key] - theirs[key]))))
            elif key.endswith("contact"):
                contact.append(float((ours[key] != theirs[key]).mean()))
        rows.append(
            [profile, f"{1e6 * white:.0f}", f"{max(height):.4f}", f"{1e6 * max(contact):.0f}"]
        )
        if not white <= WHITE_MAX_PART or not max(height) <= HEIGHT_MAX_MM[profile]:
            wrong.append(
                f"{profile}: height differs by {max(height):.3f} mm, {100 * white:.2f} % of white"
            )
    print(
        markdown(
            [
                "profile",
                "other white, px per million",
                "h, mm at most",
                "other contact, cells per million",
            ],
            rows,
        )
    )
    return wrong


def package(python: str) -> list[str]:
    """The Debian package, unpacked as dpkg would: its command, by Debian's Python,
    in its own environment.
    """
    debs = TREE / GIVEN / f"deb-{python}"
    words = ("--machine", "aarch64", "--python", python, "--level", "1", "--out", str(debs))
    subprocess.run(
        (sys.executable, "-m", "tools.release.package_debian", *words), cwd=TREE, check=True
    )
    made = max(debs.glob("*.deb"), key=lambda file: file.stat().st_mtime).relative_to(TREE)
    unpack = f"rm -rf /opt/tacshade-edge && dpkg-deb --extract {made} /"
    command = f"{GIVEN}/images/*.png --calibration {GIVEN}/calibration.npz --out /tmp/maps"
    script = f"{unpack} && cd /src && env -u PYTHONPATH tacshade-edge reconstruct {command}"
    return ["its command failed"] if arm(python, "sh", "-c", script) else []


def quick(python: str) -> list[str]:
    """Run the quick tests on the other machine; return the problems."""
    words = ("-p", "no:cacheprovider", "-n", WORKERS, "--dist", "worksteal", "-m", QUICK)
    there = (*ARM, "--python", python, "python3", "-m", "pytest", *words)
    done = subprocess.run(there, cwd=TREE, stdout=subprocess.PIPE, text=True, check=False)
    lines = done.stdout.splitlines()
    print("\n".join(lines if done.returncode else lines[-1:]))
    return ["quick tests failed"] if done.returncode else []


def count_stages(port: int) -> dict[tuple[str, str], float]:
    """Print the instructions of each stage, on one processor; return those of whole frames by
    profile and frame.
    """
    rows, whole = [], {}
    for profile in PROFILES:
        counts = iter(instructions(profile, port))
        for name, image in FRAMES.items():
            stages = stages_of(profile, image)
            totals = [next(counts) for _ in stages]
            own = dict(zip(stages, np.diff([0, *totals]), strict=True))
            cells = [f"{own[stage] / 1e6:.2f}" if stage in own else "" for stage in STAGES]
            rows.append([profile, name, *cells, f"{totals[-1] / 1e6:.1f}"])
            whole[profile, name] = totals[-1]
    print(f"Million instructions on {PROCESSOR}\n")
    print(markdown(["profile", "frame", *STAGES, "all"], rows), flush=True)
    return whole


def count_boards(port: int, whole: dict[tuple[str, str], float]) -> None:
    """Print the instructions of whole frames on each board's processor, and what they take."""
    rows = []
    for board in BOARDS:
        for profile in (each for each in PROFILES if each != "paper"):
            if board.processor == PROCESSOR:
                totals = [whole[profile, name] for name in FRAMES]
            else:
                totals = instructions(profile, port, "last", processor=board.processor)
            for name, total in zip(FRAMES, totals, strict=True):
                rows.append(
                    [board.name, profile, name, f"{total / 1e6:.1f}", board.times_ms(total)]
                )
    print("\nThe whole frame on one core of each board\n")
    print(markdown(["board", "profile", "frame", "million instructions", "ms"], rows), flush=True)


def instructions(profile: str, port: int, *which: str, processor: str = PROCESSOR) -> list[float]:
    """Those of a frame until the end of each stage, or of the last."""
    script = ["-m", "tools.ci.arm_frames", "step", str(GIVEN), profile, str(port), *which]
    return [total / COUNT for total in instructions_between(script, processor)]


def count() -> None:
    """Print the tables of instructions."""
    with tempfile.TemporaryDirectory() as folder, Broker(Path(folder)) as broker:
        count_boards(broker.port, count_stages(broker.port))


def main() -> int:
    """Run everything and print the problems at the end."""
    parser = argparse.ArgumentParser(description="What runs on a board's processor, emulated.")
    parser.add_argument("--python", nargs="+", choices=PYTHONS, default=list(PYTHONS))
    parser.add_argument("--skip-quick", action="store_true", help="without the quick tests")
    parser.add_argument(
        "--count-only", action="store_true", help="instructions of a frame, and nothing else"
    )
    args = parser.parse_args()
    (TREE / GIVEN).mkdir(parents=True, exist_ok=True)
    for words in (("write", str(GIVEN)), ("reconstruct", str(GIVEN), str(GIVEN / "here.npz"))):
        subprocess.run((sys.executable, "-m", "tools.ci.arm_frames", *words), cwd=TREE, check=True)
    wrong = []
    for python in [] if args.count_only else args.python:
        stages = {"frames": same_frames, "package": package} | (
            {} if args.skip_quick else {"quick": quick}
        )
        for name, stage in stages.items():
            began_s = time.monotonic()
            print(f"\n--- Python {python}: {name}", flush=True)
            wrong += [f"Python {python}, {name}: {what}" for what in stage(python)]
            print(f"{name}: {time.monotonic() - began_s:.0f} s", flush=True)
    print("\n--- instructions of a frame, 640x480", flush=True)
    count()
    print("\nnothing failed" if not wrong else "\nFAILED\n" + "\n".join(wrong))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
