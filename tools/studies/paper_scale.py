#!/usr/bin/env python3
"""How deep `paper` finds presses, by where its α comes from.

::

    .venv/bin/python -m tools.studies.paper_scale [--sensors 4,11,other:5,two-scales:4]

Each sensor is calibrated with 24 ball presses; the paper's five objects are pressed elsewhere to
four depths. The error is the mean of |found - true| of the greatest depth, a missed contact
counting as 0 mm. *15 px*: the paper's number; *mean depth*: every press as deep as the
calibration's presses on average; *change*: in proportion to the RMS of g_d.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np

from tacshade_edge.lab.simulator.press import OBJECTS, PAPER_OBJECTS, Press
from tacshade_edge.lab.studies.evaluate.work import PRESSES, REFERENCES, SensorName, calibrated
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Calibration, Frame
from tools.testbed.simulator.families import working_sensors

DEPTHS_MM = (0.8, 1.6, 2.4, 3.2)
REACH_MM = 4.0
ALPHA_PX = 15.0


def presses(name: SensorName) -> Iterator[tuple[U8, float]]:
    """Pictures of the paper's objects at any place and rotation, and their greatest depth in mm."""
    sensor, rng = name.make(), np.random.default_rng(1)
    scale = sensor.model.skin_radius_mm / 20
    for object_name in PAPER_OBJECTS:
        for depth_mm in DEPTHS_MM:
            x_mm, y_mm = rng.uniform(-REACH_MM, REACH_MM, 2) * scale
            turned = rng.uniform(0, 90)
            press = Press(OBJECTS[object_name](), x_mm, y_mm, depth_mm * scale, turned, scale)
            frame = sensor.frame((press,), int(rng.integers(1_000_000)))
            yield frame.image, float(np.nanmax(frame.truth().height_mm))


def errors_mm(name: SensorName) -> list[float]:
    """The mean errors of the three on one sensor."""
    made = calibrated(name, REFERENCES, PRESSES).calibration
    constant = replace(made, alpha_grey=0.0)
    ways: tuple[Calibration, ...] = (replace(constant, alpha=ALPHA_PX), constant, made)
    solvers = [Reconstructor(way, PROFILES["paper"]) for way in ways]
    off = [
        [abs(solver.step(Frame(0, 0, 0, image)).depth_max_mm - true_mm) for solver in solvers]
        for image, true_mm in presses(name)
    ]
    return [math.fsum(column) / len(column) for column in zip(*off, strict=True)]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="How deep `paper` finds presses.")
    parser.add_argument(
        "--sensors",
        type=working_sensors,
        default=working_sensors("4,11,other:5,two-scales:4"),
        metavar="SEED,...",
    )
    args = parser.parse_args()
    cv2.setNumThreads(1)
    found = {str(name): errors_mm(name) for name in args.sensors}
    found["mean"] = list(np.mean(list(found.values()), axis=0))
    lines = [[name, *(f"{error:.2f}" for error in errors)] for name, errors in found.items()]
    print(markdown(["sensor", "15 px, mm", "mean depth, mm", "change, mm"], lines))


if __name__ == "__main__":
    main()
