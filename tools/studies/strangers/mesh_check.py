"""How far states depend on the mesh: one path of a family,
solved on the usual mesh and on a finer one.

::

    nice .venv/bin/python -m tools.studies.strangers.mesh_check --family layered
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.types import F64
from tools.studies.strangers import layered, oblate, oblate_solver
from tools.studies.strangers.layered_solver import LayeredSolver, mesh_of
from tools.studies.strangers.oblate_solver import OblateSolver
from tools.studies.strangers.paths import States, paths
from tools.studies.strangers.solve import MAKERS, Solver
from tools.studies.strangers.surface import TOUCHING_MM, Surface

FINER = 3
PATH = 2
"""The judged path that is solved: a ball, pressed and dragged."""


def _layered(finer: int) -> Solver:
    skin = layered.drawn("working", 0)
    return LayeredSolver(skin, mesh_of(skin, finer))


def _oblate(finer: int) -> Solver:
    square, rings = oblate_solver.SQUARE + finer, oblate_solver.RINGS + finer
    return OblateSolver(oblate.drawn("working", 0), square, rings)


SOLVERS: dict[str, Callable[[int], Solver]] = {"layered": _layered, "oblate": _oblate}


def apart_mm(usual: States, fine: States, press: Press, radius_mm: float, stop: int) -> F64:
    """By how much the skin of a finer mesh lies elsewhere (N,),
    at its points that touch the object.
    """
    at = fine.stops_mm[stop]
    touching = press.distance_mm(radius_mm, at) <= TOUCHING_MM
    direction = fine.rest_mm / np.linalg.norm(fine.rest_mm, axis=1, keepdims=True)
    coarse = Surface(usual.rest_mm, usual.stops_mm[stop], _rest(fine.rest_mm, direction))
    return np.linalg.norm(coarse.points(direction) - at, axis=1)[touching]


def _rest(points: F64, direction: F64) -> Callable[[F64], F64]:
    """The untouched skin in the directions of its own points."""
    far = np.sum(points * direction, axis=1)
    return lambda _: far


def main(arguments: list[str] | None = None) -> int:
    """Solve, compare and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--family", choices=SOLVERS, required=True)
    family = parser.parse_args(arguments).family
    sensor = MAKERS[family]("working", 0, Path())
    path = paths(sensor.dome, "judged", sensor.seed, PATH + 1)[PATH]
    usual, fine = (SOLVERS[family](finer).solved(path.stops) for finer in (0, FINER))
    for stop, press in enumerate(path.stops):
        off_mm = apart_mm(usual, fine, press, sensor.dome.radius_mm, stop)
        what = "dragged" if press.is_dragged else "pressed"
        text = f"median {np.median(off_mm):.3f} mm, greatest {off_mm.max():.3f} mm"
        print(f"{family}, {path.object_name} {what}: {text} at {len(off_mm)} points")
    return 0


if __name__ == "__main__":
    sys.exit(main())
