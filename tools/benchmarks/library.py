"""How long a script waits: from `import tacshade_edge` to the first result, each time in a fresh process.

::

    python -m tools.benchmarks.library CAL.npz IMAGE [--profile NAME] [--rounds N]
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys

SCRIPT = """
import json, sys, time
marks = [time.perf_counter()]
def mark(): marks.append(time.perf_counter())
import tacshade_edge as ts; mark()
sensor = ts.load(sys.argv[1], profile=sys.argv[3]); mark()
sensor.reconstruct(sys.argv[2]); mark()
sensor.reconstruct(sys.argv[2]); mark()
print(json.dumps([b - a for a, b in zip(marks, marks[1:])]))
"""
STEPS = ("import tacshade_edge", "ts.load", "first reconstruct", "second reconstruct")


def main() -> None:
    """Print the median of each step and their sum up to the first result."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("calibration")
    parser.add_argument("image")
    parser.add_argument("--profile", default="balanced")
    parser.add_argument("--rounds", type=int, default=9)
    args = parser.parse_args()
    words = [sys.executable, "-c", SCRIPT, args.calibration, args.image, args.profile]
    rounds = [
        json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
        for _ in range(args.rounds + 1)
    ][1:]  # the first reads the disk
    for step, seconds in zip(STEPS, zip(*rounds, strict=True), strict=True):
        print(f"{step:22}{1e3 * statistics.median(seconds):8.1f} ms")
    print(f"{'to the first result':22}{1e3 * statistics.median(sum(one[:3]) for one in rounds):8.1f} ms")


if __name__ == "__main__":
    main()
