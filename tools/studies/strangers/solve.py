"""Solve the missing paths of a family's sensors, and store a file for each.

::

    nice .venv/bin/python -m tools.studies.strangers.solve --family layered --states FOLDER
        [--range working]
        [--sensors 4]

This needs numba (the extra `fit`). The third family has its own command (../third_family).
"""

from __future__ import annotations

import argparse
import functools
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from tacshade_edge.lab.simulator.press import Press
from tools.studies.strangers import layered, oblate
from tools.studies.strangers.layered_solver import LayeredSolver
from tools.studies.strangers.oblate_solver import OblateSolver
from tools.studies.strangers.paths import States, paths, states_file
from tools.studies.strangers.solved import COUNTS, Solved


class Solver(Protocol):
    """Moves objects on one skin."""

    def solved(self, stops: tuple[Press, ...]) -> States:
        """Move an object through its stops."""


Maker = Callable[[str, int, Path], Solved]
MAKERS: dict[str, Maker] = {
    "layered": layered.layered,
    "oblate": oblate.oblate,
}
SOLVERS: dict[str, Callable[[str, int], Solver]] = {
    "layered": lambda range_name, number: LayeredSolver(layered.drawn(range_name, number)),
    "oblate": lambda range_name, number: OblateSolver(oblate.drawn(range_name, number)),
}


def missing(sensor: Solved, kind: str) -> list[tuple[Path, tuple[Press, ...]]]:
    """Find the paths of a kind that have no file, and the stops of each."""
    wanted = [
        (states_file(sensor.states, sensor.range_name, sensor.number, kind, k), path.stops)
        for k, path in enumerate(paths(sensor.dome, kind, sensor.seed, COUNTS[kind]))
    ]
    return [(file, stops) for file, stops in wanted if not file.exists()]


def main(arguments: list[str] | None = None) -> int:
    """Solve the missing paths of a range."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--family", choices=MAKERS, required=True)
    parser.add_argument("--range", choices=("working", "final"), default="working")
    parser.add_argument("--sensors", type=int, default=4)
    parser.add_argument(
        "--states", type=Path, required=True, help="existing files stay as they are"
    )
    options = parser.parse_args(arguments)
    options.states.mkdir(parents=True, exist_ok=True)
    solver_of = functools.cache(functools.partial(SOLVERS[options.family], options.range))
    for kind in COUNTS:
        for number in range(options.sensors):
            wanted = missing(MAKERS[options.family](options.range, number, options.states), kind)
            began_s = time.monotonic()
            for file, stops in wanted:
                solver_of(number).solved(stops).write(file)
            took_s = time.monotonic() - began_s
            name = f"{options.range} {number} {kind}"
            print(f"{name}: {len(wanted)} paths in {took_s:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
