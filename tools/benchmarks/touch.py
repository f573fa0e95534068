#!/usr/bin/env python3
"""What a touch adds to the cost of a frame with depth and shear, in alternating rounds, and what learning takes.

::

    .venv/bin/python -m tools.benchmarks.touch [--rounds 20] [--frames 60] [--labels 400]
    .venv/bin/python -m tools.benchmarks.touch --learning 4000

The model is learned from simulated frames of a cylinder at any depth and tilt; the timed frame is one of them. The
second command learns six quantities from that many rows with the features of `accurate`: only its seconds and memory.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from collections.abc import Iterable
from dataclasses import replace

if "--learning" not in sys.argv:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the daemon

import cv2
import numpy as np

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.touch.learning import learn
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.inference.touch_learning import LabelledFrame, learn_touch
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.studies.evaluate.sensors import SensorName, calibrated
from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import QUANTITIES, Frame, Need

FEATURES = 4704


def frames(count: int) -> Iterable[LabelledFrame]:
    """Simulated presses with known depth and tilt."""
    sensor, random = SensorName.parse("default").make(), np.random.default_rng(3)
    for k in range(count):
        depth_mm, tilt_x_deg, tilt_y_deg = (float(v) for v in random.uniform((1.4, -15, -15), (3.0, 15, 15)))
        press = Press(OBJECTS["cylinder"](), 0.0, 0.0, depth_mm, tilt_x_deg=tilt_x_deg, tilt_y_deg=tilt_y_deg)
        known = {"depth_mm": depth_mm, "tilt_x_deg": tilt_x_deg, "tilt_y_deg": tilt_y_deg}
        yield LabelledFrame(str(k), sensor.frame((press,), k).image, known)


def learning(rows: int) -> None:
    """Learn from made-up features and print the cost."""
    random = np.random.default_rng(4)
    hidden = random.uniform(-1, 1, (rows, 60))
    features = (hidden @ random.normal(size=(60, FEATURES)) + random.normal(size=(rows, FEATURES))).astype(np.float32)
    labels = hidden[:, :6] + 0.1 * random.normal(size=(rows, 6))
    imprints = (hidden[:, :6] @ random.normal(size=(6, 4))).astype(np.float32)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began_s = time.monotonic()
    learn(features, imprints, QUANTITIES[:6], labels, np.arange(rows), "")
    took_s = time.monotonic() - began_s
    more = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) >> 10
    table = ((str(rows), f"{took_s:.1f}", str(features.nbytes >> 20), str(more)),)
    print(markdown(("rows", "learning, s", "features, MB", "and at most, MB"), table))


def main(arguments: list[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--labels", type=int, default=400)
    parser.add_argument("--learning", type=int, metavar="ROWS")
    args = parser.parse_args(arguments)
    if args.learning:
        learning(args.learning)
        return 0
    cv2.setNumThreads(1)
    calibration = calibrated(SensorName.parse("default"), 8, 40).calibration
    labelled = list(frames(args.labels))
    lines = []
    for name in ("fast", "balanced", "accurate"):
        began_s = time.monotonic()
        model = learn_touch(calibration, PROFILES[name], labelled).learnt.model
        learning_s = time.monotonic() - began_s
        assert model is not None
        made = make_reconstructor(replace(calibration, touch={name: model}), PROFILES[name])
        took: dict[Need, list[float]] = {Need.SHEAR: [], Need.TOUCH: []}
        for number in range(args.rounds):
            for need, medians in took.items():
                times = []
                for k in range(args.frames):
                    began_ns = time.perf_counter_ns()
                    made.step(Frame(k, number, 0, labelled[k % len(labelled)].image), need=need)
                    times.append((time.perf_counter_ns() - began_ns) / 1e6)
                medians.append(float(np.median(times)))
        shear, touch = (float(np.median(one)) for one in took.values())
        added = float(np.median(np.subtract(took[Need.TOUCH], took[Need.SHEAR])))
        lines.append((name, f"{shear:.2f}", f"{touch:.2f}", f"{added:.2f}", f"{learning_s:.0f}"))
    columns = ("profile", "depth and shear, ms", "and touch, ms", "it adds, ms", f"learning from {args.labels}, s")
    print(markdown(columns, lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
