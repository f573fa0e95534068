#!/usr/bin/env python3
"""Count the instructions of a run of each shipped network on an emulated Pi 5 processor; `runtime` has times on x86.

::

    .venv/bin/python -m tools.benchmarks.runtime_counts [--runs 20]

It needs what ``tools/rig/arm64.py`` needs. Counts compare runtimes with similar kernels; they ignore memory access.
"""

from __future__ import annotations

import argparse

from tacshade_edge.studies.tables import markdown
from tools.benchmarks.runtime import FLOAT, INTEGERS, NETWORKS, OPENCV, runners
from tools.rig.arm64 import instructions_each

RUNTIMES = (OPENCV, FLOAT, INTEGERS)


def main() -> None:
    """Count and print; with --run, be the counted program."""
    parser = argparse.ArgumentParser(description="Instructions of a network's run on an emulated Cortex-A76.")
    parser.add_argument("--runs", type=int, default=20, help="that are counted")
    parser.add_argument("--run", nargs=3, metavar=("NETWORK", "RUNTIME", "COUNT"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.run:
        network, runtime, count = args.run
        run = runners(network)[runtime]
        for _ in range(int(count)):
            run()
        return
    lines = []
    for name in NETWORKS:
        script = ["-m", "tools.benchmarks.runtime_counts", "--run", name]
        found = [instructions_each([*script, runtime], args.runs) for runtime in RUNTIMES]
        opencv, floats, integers = found
        millions = [f"{each / 1e6:.2f}" for each in found]
        lines.append([name, *millions, f"{opencv / floats:.2f}", f"{floats / integers:.2f}"])
    heads = ["network", *(f"{runtime}, million" for runtime in RUNTIMES), "OpenCV / float", "float / integers"]
    print(markdown(heads, lines))


if __name__ == "__main__":
    main()
