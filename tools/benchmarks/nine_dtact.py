#!/usr/bin/env python3
"""Compare the CPU time of a frame in contact with that of 9DTact's height map, in alternating
rounds on one thread.

::

    git clone https://github.com/linchangyi1/9DTact /tmp/9DTact
    .venv/bin/python -m tools.benchmarks.nine_dtact /tmp/9DTact [--rounds 12] [--frames 60]

9DTact (MIT) makes its height map by a difference from the reference, a table and three Gaussians:
about the least that a camera behind skin needs. Its
``raw_image_2_height_map`` runs on the grey of the 640x480 colour image that the profiles get, with
a table of 100 depths. Each figure is the median over rounds of a round's median; a ratio is the
median of the rounds' ratios.
"""

from __future__ import annotations

import argparse
import ast
import itertools
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np

from tacshade_edge.lab.studies.evaluate.work import SensorName, calibrated, reconstructor
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.profiles import LADDER
from tacshade_edge.types import Frame, Need
from tools.benchmarks.stages import PRESS

SOURCE = "shape_reconstruction/sensor.py"
METHOD = "raw_image_2_height_map"
NOISES, WARM_UP = 8, 3
DEEPEST_MM, DEPTHS = 2.0, 100
"""Of 9DTact's table, which its calibration fills."""


def height_map_of(checkout: Path) -> Callable[..., Any]:
    """9DTact's method, without the modules that it needs for its camera."""
    path = checkout / SOURCE
    if not path.is_file():
        raise SystemExit(f"{path}: found no such file, expected a checkout of 9DTact")
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    found = [node for node in nodes if isinstance(node, ast.FunctionDef) and node.name == METHOD]
    if len(found) != 1:
        raise SystemExit(f"{path}: found {len(found)} functions {METHOD}, expected one")
    names: dict[str, Any] = {"np": np, "cv2": cv2}
    exec(compile(ast.Module([*found], []), str(path), "exec"), names)
    method: Callable[..., Any] = names[METHOD]
    return method


def main() -> None:
    """Time both and print the comparison."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkout", type=Path, help="of 9DTact")
    parser.add_argument("--rounds", type=int, default=12)
    parser.add_argument("--frames", type=int, default=60, help="of a round")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    name = SensorName.parse("default")
    sensor, calibration = name.make(), calibrated(name, 8, 0).calibration
    images = [sensor.frame((PRESS,), 3000 + k).image for k in range(NOISES)]
    greys = [to_grey(image) for image in images]
    # With the values of its own settings file.
    other = SimpleNamespace(
        ref_GRAY=to_grey(sensor.frame((), 1).image),
        lighting_threshold=2,
        max_index=DEPTHS - 1,
        Pixel_to_Depth=np.linspace(0, DEEPEST_MM, DEPTHS),
        kernel_list=[7, 7],
    )
    height_map, clock = height_map_of(args.checkout), itertools.count(0, 16_666_667)
    steps: dict[str, Callable[[int], object]] = {
        "9DTact": lambda k: height_map(other, greys[k % NOISES])
    }
    needs = {"depth": Need.DEPTH, "depth, shear": Need.DEPTH | Need.SHEAR}
    for profile, (what, need) in itertools.product(LADDER, needs.items()):
        made = partial(reconstructor(calibration, profile).step, need=need)
        steps[f"{profile}: {what}"] = lambda k, made=made: made(
            Frame(0, next(clock), 0, images[k % NOISES])
        )
    p50_ms: dict[str, list[float]] = {what: [] for what in steps}
    for _ in range(args.rounds):
        for what, step in steps.items():
            p50_ms[what].append(round_ms(step, args.frames))
    floor_ms = np.array(p50_ms["9DTact"])
    lines = [
        [what, f"{np.median(ms):.2f}", f"{np.median(np.array(ms) / floor_ms):.2f}"]
        for what, ms in p50_ms.items()
    ]
    print(markdown(["method", "p50 ms", "of 9DTact"], lines))


def round_ms(step: Callable[[int], object], frames: int) -> float:
    """The median of a round's frames, in ms of the processor."""
    taken_ns = []
    for k in range(-WARM_UP, frames):
        began_ns = time.process_time_ns()
        step(k)
        if k >= 0:
            taken_ns.append(time.process_time_ns() - began_ns)
    return float(np.median(taken_ns)) / 1e6


if __name__ == "__main__":
    main()
