#!/usr/bin/env python3
"""What the simulator's parts cost in NumPy, and compiled for a fit.

::

    .venv/bin/python -m tools.benchmarks.compiled_skin [--rounds 5]

One dragged press. This needs numba (the extra `fit`); compiling it is timed apart, as the first
call in a process with an empty cache.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable

import numpy as np

from tacshade_edge.lab.simulator import skin, truth
from tacshade_edge.lab.simulator.drag import drag_skin
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.simulator.render import carried
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.types import F32

POINTS = 112 * 112
"""As many as a network has cells."""
NODES = 128
Call = Callable[[], object]


def least_s(call: Call, rounds: int) -> float:
    """Processor time of a call, the least of some rounds."""
    taken = []
    for _ in range(rounds):
        start = time.process_time()
        call()
        taken.append(time.process_time() - start)
    return min(taken)


def parts() -> list[tuple[str, Call, Call]]:
    """Each part's name, and a call of either kind with the same input."""
    from tacshade_edge.lab.fitting import compiled  # numba is needed only here

    model, rng = SensorModel(), np.random.default_rng(0)
    presses = (Press(OBJECTS["cube"](), 2.0, -1.0, 3.0, drag_x_mm=2.0, twist_deg=5.0),)

    def pressed(lean: F32 | None = None) -> skin.Skin:
        return skin.press_skin(20.0, model.skin_decay_mm, presses, lean)

    dragged = drag_skin(pressed, model, presses)
    chart = rng.uniform(-14, 14, (POINTS, 2))
    rows, cols = rng.uniform(60, 420, POINTS), rng.uniform(150, 500, POINTS)
    points = truth.skin_points(dragged, model.geometry, rows, cols)
    obstacle = rng.uniform(-1, 1, (NODES, NODES)).clip(0).astype(np.float32)
    mass = np.full((NODES, NODES), 0.02, np.float32)
    held = rng.normal(1, 0.2, (2, NODES, NODES)).astype(np.float32)
    return [
        (
            "the membrane",
            lambda: skin.solve(obstacle, mass),
            lambda: compiled.solve(obstacle, mass),
        ),
        (
            "its slip",
            lambda: skin.slid(held, 0.2 * obstacle, mass),
            lambda: compiled.slid(held, 0.2 * obstacle, mass),
        ),
        (
            "what pixels see",
            lambda: truth.skin_points(dragged, model.geometry, rows, cols),
            lambda: compiled.skin_points(dragged, model.geometry, rows, cols),
        ),
        (
            "where points move",
            lambda: carried(dragged, chart, 0.9),
            lambda: compiled.carried(dragged, chart, 0.9),
        ),
        (
            "their shear",
            lambda: truth.shear_mm(dragged, points, 0.9),
            lambda: compiled.shear_mm(dragged, points, 0.9),
        ),
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    with tempfile.TemporaryDirectory() as cache:
        os.environ["NUMBA_CACHE_DIR"] = cache
        lines = []
        for name, plain, fast in parts():
            first_s = least_s(fast, 1)
            plain_s, fast_s = least_s(plain, rounds), least_s(fast, rounds)
            lines.append(
                (
                    name,
                    f"{1e3 * plain_s:.1f}",
                    f"{1e3 * fast_s:.1f}",
                    f"{plain_s / fast_s:.1f}",
                    f"{first_s:.1f}",
                )
            )
    print(markdown(("part", "NumPy, ms", "compiled, ms", "ratio", "compiling, s"), lines))


if __name__ == "__main__":
    main()
