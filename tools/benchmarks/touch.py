#!/usr/bin/env python3
"""What a touch costs beyond depth and shear, by CPU time,
with a model of labels as large as it can get.

::

    .venv/bin/python -m tools.benchmarks.touch [--rounds 40] [--frames 25] [--profile fast accurate]

Rounds with and without the touch take turns on one thread; a figure is the median of the rounds,
with its quartiles. The model's numbers are random: only their sizes cost time.
"""

from __future__ import annotations

import argparse
import time

import cv2
import numpy as np

from tacshade_edge.lab.studies.evaluate.work import SensorName, calibrated
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.inference.network import load_network
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.sensor.touch.learning import CENTRES, COMPONENTS, DIRECTIONS, FUNCTIONS
from tacshade_edge.types import F32, QUANTITIES, Calibration, Frame, Need, TouchModel
from tools.benchmarks.stages import PRESS

NAMES = QUANTITIES[:9]


def largest_model(features: int) -> TouchModel:
    """A model of as many labels as it can use, whose answers mean nothing."""
    random, few, functions = np.random.default_rng(0), len(NAMES), DIRECTIONS + CENTRES
    terms = (few + 1) * (few + 2) // 2

    def drawn(*shape: int) -> F32:
        return random.normal(size=shape).astype(np.float32) / np.float32(shape[0])

    ones = np.ones(few, np.float32)
    return TouchModel(
        names=NAMES,
        networks="n",
        mean=drawn(features),
        deviation=np.ones(features, np.float32),
        components=drawn(features, COMPONENTS),
        scale=1.0,
        spread=np.ones(COMPONENTS, np.float32),
        origin=drawn(COMPONENTS),
        metric=drawn(2 * COMPONENTS, DIRECTIONS),
        gate_part=0.0,
        centres=drawn(CENTRES, DIRECTIONS),
        width=1.0,
        basis=drawn(functions, FUNCTIONS),
        weights=drawn(functions, few),
        precision=np.ones((FUNCTIONS, few), np.float32),
        ridge=ones,
        offset=ones,
        noise=ones,
        low=-9e5 * ones,
        high=9e5 * ones,
        leverage_max=9e5,
        residual_max=9e5,
        imprint_weights=drawn(terms, 4),
        imprint_precision=drawn(4, 4),
        imprint_max=9e5,
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="What a touch costs beyond depth and shear.")
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--frames", type=int, default=25, help="in each round")
    learned = [name for name in PROFILES if name != "paper"]
    parser.add_argument("--profile", nargs="+", choices=learned, default=learned)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    name = SensorName.parse("default")
    sensor, calibration = name.make(), calibrated(name, 8, 0).calibration
    frame = Frame(0, 0, 0, to_grey(sensor.frame((PRESS,), 7).image))
    lines = []
    for profile in args.profile:
        made = with_model(calibration, profile, frame)
        taken: dict[Need, list[float]] = {Need.SHEAR: [], Need.TOUCH: []}
        for _ in range(args.rounds):
            for need, found in taken.items():
                began_s = time.thread_time()
                for _ in range(args.frames):
                    made.step(frame, need=need)
                found.append(1e3 * (time.thread_time() - began_s) / args.frames)
        more = np.array(taken[Need.TOUCH]) - np.array(taken[Need.SHEAR])
        figures = np.median(taken[Need.SHEAR]), *np.quantile(more, (0.5, 0.25, 0.75))
        lines.append((profile, *(f"{each:.3f}" for each in figures)))
    print(
        markdown(
            ("profile", "depth and shear, ms", "touch, ms more", "lower quartile", "upper"), lines
        )
    )


def with_model(calibration: Calibration, profile: str, frame: Frame) -> Reconstructor:
    """A profile with the largest model of its features."""
    network = PROFILES[profile].network
    assert network is not None
    features: list[F32] = []
    learner = Reconstructor(
        calibration, PROFILES[profile], load_network(network), touch=features.append
    )
    learner.step(frame)
    model = largest_model(len(features[0]))
    return Reconstructor(calibration, PROFILES[profile], load_network(network), touch=model)


if __name__ == "__main__":
    main()
