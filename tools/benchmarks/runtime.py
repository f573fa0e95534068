#!/usr/bin/env python3
"""Time the shipped networks in OpenCV's DNN module and in ONNX Runtime, also quantised, on one thread, in turns.

::

    .venv/bin/python -m tools.benchmarks.runtime [--rounds 5] [--runs 200]

Each figure is the median over the rounds of a round's median (p50) or 99th percentile (p99); ratios are of p50.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import cv2
import numpy as np
import onnxruntime

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import WEIGHTS, in_integers
from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import F32
from tools.benchmarks.stages import timed_ms

NETWORKS = (*(profile.network for profile in PROFILES.values() if profile.network), "shear")
OPENCV, FLOAT, INTEGERS = "OpenCV", "ONNX Runtime", "integers"


def runners(name: str) -> dict[str, Callable[[], F32]]:
    """Functions that run a shipped network once on the same random maps in each runtime and return the first output."""
    cv2.setNumThreads(1)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    path = WEIGHTS / f"{name}.onnx"
    data = path.read_bytes()
    session, integers = (
        onnxruntime.InferenceSession(each, options, providers=["CPUExecutionProvider"])
        for each in (data, in_integers(path, data))
    )
    rng = np.random.default_rng(0)
    maps = {each.name: rng.random(each.shape, dtype=np.float32) for each in session.get_inputs()}
    net = cv2.dnn.readNetFromONNX(str(path))

    def by_opencv() -> F32:
        for name, values in maps.items():
            net.setInput(values, name)
        return np.asarray(net.forward())

    return {
        OPENCV: by_opencv,
        FLOAT: lambda: session.run(None, maps)[0],
        INTEGERS: lambda: integers.run(None, maps)[0],
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="OpenCV's DNN module beside ONNX Runtime.")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--runs", type=int, default=200, help="in each round")
    args = parser.parse_args()
    lines = []
    for name in NETWORKS:
        made = runners(name)
        off = float(np.abs(made[OPENCV]() - made[FLOAT]()).max())
        found = [[timed_ms(run, args.runs) for run in made.values()] for _ in range(args.rounds)]
        (p50, p99), (other50, other99), (integer50, integer99) = np.median(found, axis=0)
        figures = [f"{value:.3f}" for value in (p50, p99, other50, other99)]
        integer = [f"{integer50:.3f}", f"{integer99:.3f}", f"{other50 / integer50:.2f}"]
        lines.append([name, *figures, f"{p50 / other50:.2f}", f"{off:.1e}", *integer])
    heads = ["network", "OpenCV p50 ms", "p99", "ONNX Runtime p50 ms", "p99", "ratio", "greatest difference"]
    heads += ["integers p50 ms", "p99", "ratio"]
    print(f"OpenCV {cv2.__version__}, ONNX Runtime {onnxruntime.__version__}\n")
    print(markdown(heads, lines))


if __name__ == "__main__":
    main()
