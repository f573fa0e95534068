#!/usr/bin/env python3
"""What a frame costs, stage by stage, compared with the least that any method needs: one threshold and one box filter.

::

    .venv/bin/python -m tools.benchmarks.stages [--rounds 5] [--frames 200] [--profile fast accurate]

The frames are 640x480 grey images in memory; use one thread of an idle machine. The floor is `cv2.threshold` and
`cv2.boxFilter` uint8 to uint16 over the whole frame. Rounds of the floor, of frames without contact and of frames in
contact take turns; each figure is the median over the rounds of a round's median (p50) or 99th percentile (p99). A
stage's figure covers the frames that ran it.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Callable, Iterator

import cv2
import numpy as np

from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import STAGES, Reconstructor
from tacshade_edge.simulator.press import OBJECTS, Press
from tacshade_edge.studies.evaluate.work import SensorName, calibrated, reconstructor
from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import U8, Frame

BOX_PX = 39
_clock_ns = itertools.count(0, 16_666_667)
PRESS = Press(OBJECTS["cube"](), 0.0, 0.0, 3.0, 20.0, 1.45)
"""A press that covers a fifth of the default sensor's disc."""


def stages_ms(made: Reconstructor, frame: Frame) -> dict[str, float]:
    """Run one step; return the milliseconds of each stage that ran, in order. Their sum is the step's time."""
    taken: dict[str, float] = {}
    last = time.perf_counter_ns()

    def mark(stage: str) -> None:
        nonlocal last
        now = time.perf_counter_ns()
        taken[stage] = (now - last) / 1e6
        last = now

    made.step(frame, mark)
    return taken


def next_frame(image: U8) -> Frame:
    """The next frame with this image, 1/60 s after the last one."""
    return Frame(0, next(_clock_ns), 0, image)


def timed_ms(step: Callable[[], object], count: int) -> tuple[float, float]:
    """p50 and p99 in ms of `count` calls."""
    taken = np.empty(count)
    for k in range(count):
        start = time.perf_counter_ns()
        step()
        taken[k] = (time.perf_counter_ns() - start) / 1e6
    return float(np.median(taken)), float(np.percentile(taken, 99))


def median_stages_ms(made: Reconstructor, images: Iterator[U8], count: int) -> dict[str, float]:
    """Median in ms of each stage over those of `count` steps that ran it."""
    taken = [stages_ms(made, next_frame(image)) for image in itertools.islice(images, count)]
    ran = {stage: [each[stage] for each in taken if stage in each] for stage in STAGES}
    return {stage: float(np.median(values)) for stage, values in ran.items() if values}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="What a frame costs, beside a threshold and a box filter.")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--frames", type=int, default=200, help="in each round")
    learned = [name for name in PROFILES if name != "paper"]
    parser.add_argument("--profile", nargs="+", choices=list(PROFILES), default=learned)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    name = SensorName.parse("default")
    sensor, calibration = name.make(), calibrated(name, 8, 0).calibration
    pressed = sensor.frame((PRESS,), 7)
    true = pressed.truth()
    # Frames of an untouched skin differ only by noise; most are judged like the previous one.
    drawn = {
        "no contact": [to_grey(sensor.frame((), seed).image) for seed in (8, 9)],
        "contact": [to_grey(pressed.image)],
    }
    images = {what: itertools.cycle(each) for what, each in drawn.items()}
    covered = true.contact.sum() / np.isfinite(true.height_mm).sum()

    def floor(image: U8 = drawn["contact"][0]) -> None:
        cv2.threshold(image, 100, 1, cv2.THRESH_BINARY)
        cv2.boxFilter(image, cv2.CV_16U, (BOX_PX, BOX_PX), normalize=False, borderType=cv2.BORDER_CONSTANT)

    made = {profile: reconstructor(calibration, profile) for profile in args.profile}
    steps: dict[tuple[str, str], Callable[[], object]] = {("floor", ""): floor}
    for profile, each in made.items():
        for what, image in images.items():
            steps[profile, what] = lambda each=each, image=image: each.step(next_frame(next(image)))
    rounds: dict[tuple[str, str], list[tuple[float, float]]] = {key: [] for key in steps}
    parts: dict[tuple[str, str], list[dict[str, float]]] = {key: [] for key in steps}
    for _ in range(args.rounds):
        for key, step in steps.items():
            count = args.frames if key[0] != "paper" else 3
            rounds[key].append(timed_ms(step, count))
            if key[0] in made:
                parts[key].append(median_stages_ms(made[key[0]], images[key[1]], count))
    least = float(np.median([p50 for p50, _ in rounds["floor", ""]]))
    lines = []
    for (profile, what), found in rounds.items():
        p50, p99 = (float(np.median(values)) for values in zip(*found, strict=True))
        shown = [
            f"{np.median([part[stage] for part in parts[profile, what]]):.3f}"
            if parts[profile, what] and stage in parts[profile, what][0]
            else ""
            for stage in STAGES
        ]
        lines.append([profile, what, f"{p50:.3f}", f"{p99:.3f}", f"{p50 / least:.1f}", *shown])
    print(f"A contact that covers {100 * covered:.0f} % of the disc; ms, and times the floor\n")
    print(markdown(["method", "what", "p50 ms", "p99 ms", "floors", *STAGES], lines))


if __name__ == "__main__":
    main()
