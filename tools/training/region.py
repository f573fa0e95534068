#!/usr/bin/env python3
"""What a window around a contact would save of a network's time, and what it would change.

::

    .venv-train/bin/python -m tools.training.region [--presses 26]

The network answers each press in float32 from all cells, and from a square window with a half or a
quarter of them around the contact. A height's change is in mm, over the contact's cells inside the
window: its mean, as the median over presses, and its greatest of all.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
import onnx
import onnxruntime

from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.studies.evaluate.work import PressedSensor, SensorName, calibrated
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.depth.learned import (
    LearnedSolver,
    as_learnt,
    fold,
    known_maps,
    scale_mm,
    unfold,
)
from tacshade_edge.sensor.image.preprocess import Preprocessor
from tacshade_edge.sensor.inference.network import WEIGHTS, load_network
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import F32, U8, Bool, Calibration
from tools.studies.command import NETWORKS

PARTS = {"half": math.sqrt(0.5), "quarter": 0.5}
"""A window's side, of all cells' side."""
OFF_MIDDLE_MM = 4.0
RUNS = 5

A = TypeVar("A", F32, Bool)


@dataclass(frozen=True, slots=True)
class Region:
    """A square window of folded cells."""

    row0: int
    col0: int
    side: int

    def cut(self, maps: A, by: int = 1) -> A:
        """Cut it out of maps (C, N, N) whose cells are `by` times as fine."""
        first_row, first_col, side = (by * each for each in (self.row0, self.col0, self.side))
        window: A = maps[:, first_row : first_row + side, first_col : first_col + side]
        return window.copy()


def region_around(contact: Bool, by: int, part: float, unit: int) -> Region:
    """The window in the middle of a contact (N, N), of whole units, which the levels halve."""
    whole = len(contact) // by
    side = math.ceil(part * whole / unit) * unit
    first: list[int] = []
    for cells in np.nonzero(contact):
        middle = (int(cells.min()) + int(cells.max())) / 2 / by
        first.append(min(max(round((middle - side / 2) / unit) * unit, 0), whole - side))
    return Region(row0=first[0], col0=first[1], side=side)


class AnySize:
    """A shipped network of depth in float32, for any number of cells, prepared for one sensor."""

    def __init__(self, name: str, calibration: Calibration) -> None:
        profile = PROFILES[name]
        assert profile.network is not None  # of `NETWORKS`
        network = load_network(profile.network)
        self._pre = Preprocessor(calibration, profile)
        self._solver = LearnedSolver(self._pre, network)
        self.fold = network.fold
        geometry = self._pre.calibration.geometry
        known = known_maps(
            as_learnt(geometry), self._pre.calibration.pitch_px, self._solver.reference, self.fold
        )
        self._sensor = network.sense(known)
        self._mm = scale_mm(geometry)
        model = onnx.load_from_string((WEIGHTS / f"{profile.network}.onnx").read_bytes())
        for value in (*model.graph.input, *model.graph.output):
            for axis in (2, 3):
                value.type.tensor_type.shape.dim[axis].dim_param = f"{value.name}{axis}"
        del model.graph.value_info[:]
        self.unit = 2 ** sum(node.op_type == "MaxPool" for node in model.graph.node)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3
        self._session = onnxruntime.InferenceSession(
            model.SerializeToString(), options, providers=["CPUExecutionProvider"]
        )

    def white(self, image: U8) -> F32:
        """The folded white of a camera's image."""
        seen = self._pre.preprocess(self._pre.grey(image))
        return fold(self._solver.white(seen)[None], self.fold)

    def answer(self, white: F32, region: Region | None = None) -> tuple[F32, F32, float]:
        """Height in mm, log odds of contact, and the least time in ms of some runs."""
        sensor = self._sensor
        if region is not None:
            white, sensor = region.cut(white), region.cut(sensor)
        taken_ms = []
        for _ in range(RUNS):
            began_s = time.perf_counter()
            maps, _ = self._session.run(None, {"white": white[None], "sensor": sensor[None]})
            taken_ms.append(1e3 * (time.perf_counter() - began_s))
        height, logit = unfold(maps[0], self.fold)
        return height * self._mm, logit, min(taken_ms)


def presses_of(sensor: PressedSensor, count: int) -> list[U8]:
    """Images of small presses by every object in turn, not far from the middle."""
    rng = np.random.default_rng(0)
    images = []
    for number in range(count):
        shape = OBJECTS[list(OBJECTS)[number % len(OBJECTS)]]()
        x_mm, y_mm = rng.uniform(-OFF_MIDDLE_MM, OFF_MIDDLE_MM, 2)
        press = Press(shape, x_mm, y_mm, rng.uniform(1, 3), rng.uniform(0, 90), 0.5)
        images.append(sensor.frame((press,), number).image)
    return images


def compare(name: str, calibration: Calibration, images: list[U8]) -> list[list[str]]:
    """A row for all cells and for each window."""
    network = AnySize(name, calibration)
    whole_ms: list[float] = []
    found: dict[str, list[tuple[float, float, float]]] = {what: [] for what in PARTS}
    for image in images:
        white = network.white(image)
        height, logit, taken_ms = network.answer(white)
        whole_ms.append(taken_ms)
        contact = logit > 0
        for what, part in PARTS.items():
            region = region_around(contact, network.fold, part, network.unit)
            own, _, own_ms = network.answer(white, region)
            inside = region.cut(contact[None], network.fold)[0]
            change = np.abs(own - region.cut(height[None], network.fold)[0])[inside]
            found[what].append((float(change.mean()), float(change.max()), own_ms))
    rows = [[name, "all", f"{np.median(whole_ms):.2f}", "1.00", "", ""]]
    for what, of_presses in found.items():
        mean, greatest, own_ms = np.array(of_presses).T
        ratio = f"{np.median(own_ms / np.array(whole_ms)):.2f}"
        changes = [f"{np.median(mean):.3f}", f"{greatest.max():.3f}"]
        rows.append([name, what, f"{np.median(own_ms):.2f}", ratio, *changes])
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--presses", type=int, default=26)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    name = SensorName.parse("default")
    calibration, images = calibrated(name, 8, 40).calibration, presses_of(name.make(), args.presses)
    rows = [row for each in NETWORKS for row in compare(each, calibration, images)]
    print(markdown(["network", "cells", "ms", "of all", "mean change mm", "greatest mm"], rows))


if __name__ == "__main__":
    main()
