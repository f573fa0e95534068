"""The cost of stitching 1000 presses of 3000 points, one after another, and of ending the session.

    .venv/bin/python -m tools.benchmarks.stitch

Prints (with --json as JSON) the median milliseconds of an ADD over the first and the last hundred, the seconds of the
END, and the memory. Times are processor times on one thread. The presses lie 8 mm apart on a wavy surface, at poses
with the noise of `simulate --pad`; the points are those of a contact of 8.6 mm radius.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import time

import numpy as np

from tacshade_edge.core.stitching.press_points import PressPoints
from tacshade_edge.core.stitching.stitcher import Stitcher
from tacshade_edge.rigid import Rigid, from_seven, shift
from tacshade_edge.simulator.pad import disturbed

APEX_MM = 20.0
PITCH_MM = 8.0
RADIUS_MM = 8.6


def scan(count: int) -> list[Rigid]:
    """Poses of a square of presses straight down, row by row."""
    side = math.ceil(math.sqrt(count))
    down = from_seven((0, 0, 0, 0, 1, 0, 0))
    return [shift(PITCH_MM * (k % side), PITCH_MM * (k // side), APEX_MM) @ down for k in range(count)]


def touch(pose: Rigid, points: int, rng: np.random.Generator) -> PressPoints:
    """The points of the surface that a press touches."""
    x0, y0, _ = pose.apply(np.array((0, 0, APEX_MM)))
    rho, angle = RADIUS_MM * np.sqrt(rng.uniform(size=points)), rng.uniform(0, 2 * math.pi, points)
    x, y = x0 + rho * np.cos(angle), y0 + rho * np.sin(angle)
    z = 0.5 * np.sin(x / 4) * np.cos(y / 5) + rng.normal(0, 0.05, points)
    local = pose.inverse().apply(np.stack((x, y, z), axis=1)).astype(np.float32)
    return PressPoints(
        local, np.broadcast_to(np.array((0, 0, 1), np.float32), local.shape), np.ones(points, np.float32)
    )


def main() -> None:
    """Run the presses and print the cost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--presses", type=int, default=1000)
    parser.add_argument("--points", type=int, default=3000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rng = np.random.default_rng(0)
    poses = scan(args.presses)
    told = disturbed(poses, APEX_MM, 0.3, 1.0, seed=0)
    stitcher, add_ms = Stitcher(APEX_MM), []
    before_mb = resident_mb()
    for pose, reported in zip(poses, told, strict=True):
        one = touch(pose, args.points, rng)
        start = time.process_time()
        stitcher.add(one, reported)
        add_ms.append(1000 * (time.process_time() - start))
    held_mb = resident_mb() - before_mb
    start = time.process_time()
    finished = stitcher.finish()
    part = min(100, args.presses // 2)
    first, last = float(np.median(add_ms[:part])), float(np.median(add_ms[-part:]))
    figures = {
        "presses": args.presses,
        "points": args.points,
        "add_ms_first": round(first, 3),
        "add_ms_last": round(last, 3),
        "last_over_first": round(last / first, 3),
        "end_s": round(time.process_time() - start, 2),
        "refined": finished.refined,
        "tiles": stitcher.map.tiles,
        "held_mb": round(held_mb, 1),
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - before_mb, 1),
    }
    if args.json:
        print(json.dumps(figures))
        return
    for key, value in figures.items():
        print(f"{key:16} {value}")


def resident_mb() -> float:
    """The process's resident memory in MB."""
    with open("/proc/self/statm", encoding="ascii") as stream:
        return int(stream.read().split()[1]) * resource.getpagesize() / 2**20


if __name__ == "__main__":
    main()
