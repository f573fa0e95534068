#!/usr/bin/env python3
"""How long the paper's method takes as printed, compared with profile `paper` (same result, less time) and the others.

::

    .venv/bin/python -m tools.benchmarks.paper [--rounds 5] [--frames 200] [--objects cube ball]

`plain` is `plain_paper.py`: a reader's transcription of the paper's denoising and depth. The stages before (check,
threshold, eq. 1, gate) and after (cloud) are the profile's own. The frame is that of `benchmarks.stages`, in memory, on
one thread of an idle machine; methods take turns in rounds, `plain` and `paper` with a fortieth of the frames. A figure
is the median over the rounds of a round's median (p50) or 99th percentile (p99).

ME and SD are means over the paper's five objects near the tip of the default sensor, at three depths. `plain` must
find the heights of `paper`: if one differs by more than `SAME` times the greatest height, the exit code is 1.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from statistics import median

import numpy as np

from tacshade_edge.core.depth.hybrid_sfs import HybridSfs
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.simulator.objects import PAPER_OBJECTS
from tacshade_edge.studies.evaluate.scenes import DEPTHS_MM, scenes
from tacshade_edge.studies.evaluate.score import KnownTruth, Label, Row, score
from tacshade_edge.studies.evaluate.sensors import PressedSensor, SensorName, calibrated, reconstructor
from tacshade_edge.studies.evaluate.summary import figures
from tacshade_edge.studies.stage_times import one_thread
from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import U8, Calibration
from tools.benchmarks import plain_paper
from tools.benchmarks.stages import PRESS, next_frame, timed_ms

PLAIN, PAPER, BASE = "plain", "paper", "balanced"
SAME = 1e-3
"""Relative tolerance: another machine may round powers differently, and eq. 11 amplifies the difference."""


def plain(calibration: Calibration) -> Reconstructor:
    """A reconstructor of profile `paper` with the transcription's denoising and solver."""
    method = partial(HybridSfs, denoise=plain_paper.denoise, depth=plain_paper.solve)
    return Reconstructor(calibration, replace(PROFILES[PAPER], name=PLAIN), make_solver=method)


def timed(methods: dict[str, Reconstructor], image: U8, rounds: int, frames: int) -> dict[str, tuple[float, float]]:
    """p50 and p99 in ms of each method."""
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in methods}
    for _ in range(rounds):
        for name, made in methods.items():
            count = frames if name not in (PLAIN, PAPER) else max(1, frames // 40)
            taken[name].append(timed_ms(lambda made=made: made.step(next_frame(image)), count))
    return {name: (median(p50 for p50, _ in each), median(p99 for _, p99 in each)) for name, each in taken.items()}


def scored(
    methods: dict[str, Reconstructor], sensor: PressedSensor, name: SensorName, objects: Sequence[str]
) -> tuple[list[Row], float]:
    """Every method's presses, and the greatest difference of `plain` and `paper` relative to the greatest height."""
    rows: list[Row] = []
    worst = 0.0
    for object_name in objects:
        for scene in scenes(sensor.model, name.seed, object_name)[: len(DEPTHS_MM)]:
            frame = sensor.frame((scene.press,), scene.noise_seed)
            truth = KnownTruth.of(frame.truth())
            found = {method: made.step(next_frame(to_grey(frame.image))) for method, made in methods.items()}
            rows += [score(Label(str(name), object_name), truth, each) for each in found.values()]
            one, other = (found[method].height.height_mm for method in (PLAIN, PAPER))
            worst = max(worst, float(np.nanmax(np.abs(one - other)) / np.nanmax(other)))
    return rows, worst


def main() -> int:
    """Measure and print; return 1 if `plain` and `paper` differ."""
    parser = argparse.ArgumentParser(description="How long the paper's method takes as printed, beside the profiles.")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--frames", type=int, default=200, help="in each round")
    parser.add_argument("--objects", nargs="+", choices=PAPER_OBJECTS, default=PAPER_OBJECTS)
    args = parser.parse_args()
    name = SensorName.parse("default")
    sensor, calibration = name.make(), calibrated(name, 8, 40).calibration
    methods = {PLAIN: plain(calibration), **{p: reconstructor(calibration, p) for p in (PAPER, BASE, "fast")}}
    with one_thread():
        rows, worst = scored(methods, sensor, name, args.objects)
        times = timed(methods, to_grey(sensor.frame((PRESS,), 7).image), args.rounds, args.frames)
    lines = []
    for method, (p50, p99) in times.items():
        f = figures(r for r in rows if r.profile == method)
        lines.append(
            [method, f"{p50:.2f}", f"{p99:.2f}", f"{p50 / times[BASE][0]:.1f}", f"{f.me_mm:.3f}", f"{f.sd_pct:.1f}"]
        )
    print(markdown(["method", "p50 ms", "p99 ms", f"times {BASE}", "ME mm", "SD %"], lines))
    print(f"\nHeights of {PLAIN} are at most {100 * worst:.2g} % of the greatest off those of {PAPER}")
    if worst > SAME:
        print(f"paper: {PLAIN} is not {PAPER}: expected at most {100 * SAME:g} %", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
