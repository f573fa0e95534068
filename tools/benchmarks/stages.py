#!/usr/bin/env python3
"""What a frame costs, stage by stage, compared with the least that any method needs:
one threshold and one box filter.

::

    .venv/bin/python -m tools.benchmarks.stages [--rounds 5] [--frames 200]
        [--profile fast accurate]

The frames are 640x480 grey images in memory; use one thread of an idle machine. The floor is
`cv2.threshold` and `cv2.boxFilter` uint8 to uint16 over the whole frame. Rounds of the floor, of
frames without contact and of frames in contact take turns; each figure is the median over the
rounds of a round's median (p50) or 99th percentile (p99). A stage's figure covers the frames that
ran it.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable

import cv2
import numpy as np

from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.studies.evaluate.work import SensorName, calibrated, reconstructor
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.lab.studies.tradeoff.timing import Parts
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import STAGES, Reconstructor
from tacshade_edge.types import U8, Frame

BOX_PX = 39
_clock_ns = itertools.count(0, 16_666_667)
PRESS = Press(OBJECTS["cube"](), 0.0, 0.0, 3.0, 20.0, 1.45)
"""A press that covers a fifth of the default sensor's disc."""


def stages_ms(made: Reconstructor, image: U8) -> dict[str, float]:
    """Step 1/60 s after the last frame; return the milliseconds of each stage that ran."""
    parts = Parts()
    made.step(Frame(0, next(_clock_ns), 0, image), parts)
    return parts.ms


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description="What a frame costs, beside a threshold and a box filter."
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--frames", type=int, default=200, help="in each round")
    parser.add_argument("--profile", nargs="+", choices=list(PROFILES), default=list(PROFILES))
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

    def floor(image: U8 = drawn["contact"][0]) -> dict[str, float]:
        parts = Parts()
        cv2.threshold(image, 100, 1, cv2.THRESH_BINARY)
        cv2.boxFilter(
            image, cv2.CV_16U, (BOX_PX, BOX_PX), normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        parts("floor")
        return parts.ms

    steps: dict[tuple[str, str], Callable[[], dict[str, float]]] = {("floor", ""): floor}
    for profile in args.profile:
        each = reconstructor(calibration, profile)
        for what, image in images.items():
            steps[profile, what] = lambda each=each, image=image: stages_ms(each, next(image))
    rounds: dict[tuple[str, str], list[tuple[float, float]]] = {key: [] for key in steps}
    parts: dict[tuple[str, str], list[dict[str, float]]] = {key: [] for key in steps}
    for _ in range(args.rounds):
        for key, step in steps.items():
            taken = [step() for _ in range(args.frames)]
            p50, p99 = np.percentile([sum(each.values()) for each in taken], (50, 99))
            rounds[key].append((float(p50), float(p99)))
            ran = {stage: [each[stage] for each in taken if stage in each] for stage in STAGES}
            parts[key].append({stage: float(np.median(ms)) for stage, ms in ran.items() if ms})
    least = float(np.median([p50 for p50, _ in rounds["floor", ""]]))
    lines = []
    for (profile, what), found in rounds.items():
        p50, p99 = (float(np.median(values)) for values in zip(*found, strict=True))
        found_ms = [
            [part[stage] for part in parts[profile, what] if stage in part] for stage in STAGES
        ]
        shown = [f"{np.median(ms):.3f}" if ms else "" for ms in found_ms]
        lines.append([profile, what, f"{p50:.3f}", f"{p99:.3f}", f"{p50 / least:.1f}", *shown])
    print(f"A contact that covers {100 * covered:.0f} % of the disc; ms, and times the floor\n")
    print(markdown(["method", "what", "p50 ms", "p99 ms", "floors", *STAGES], lines))


if __name__ == "__main__":
    main()
