"""Table I's objects on the third family, from solved states.

MuJoCo's primitive solids are convex, so a crescent is a row of narrow boxes.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tacshade_edge.lab.simulator.press import OBJECTS, PAPER_OBJECTS, Press
from tacshade_edge.lab.studies.evaluate.score import KnownTruth, Label
from tacshade_edge.lab.studies.evaluate.work import SCENE_NOISE, Case
from tacshade_edge.types import Calibration
from tools.studies.third_family.domes import (
    FIRST_SEED,
    ROUNDING_MM,
    SOLIDS,
    Dome,
    Kept,
    Solid,
    Way,
    deepest_mm,
    deformed,
    drawn,
    kept_file,
    renderer,
    seen_truth,
)
from tools.studies.third_family.evaluate import calibrated

WHAT = "table-i"
"""Names the files of these states."""
DEPTH_MM = 3.0
SLICE_MM = 0.4
_LEVEL_MM = 15.0  # half the height of extruded solids


def slices(name: str) -> tuple[Solid, ...]:
    """Cut an extruded object, smaller by `ROUNDING_MM`, into boxes along x."""
    axis = np.arange(-10, 10, 0.02)
    made = []
    for y in np.arange(-10 + SLICE_MM / 2, 10, SLICE_MM):
        line = np.stack((axis, np.full_like(axis, y), np.full_like(axis, _LEVEL_MM)), axis=1)
        inside = axis[OBJECTS[name]().sdf(line) <= -ROUNDING_MM]
        if len(inside):
            low, high = float(inside[0]), float(inside[-1])
            sizes = (high - low) / 2, SLICE_MM / 2, _LEVEL_MM - ROUNDING_MM
            made.append(("box", sizes, ((low + high) / 2, float(y), _LEVEL_MM), (0.0, 0.0, 0.0)))
    return tuple(made)


TABLE_I_SOLIDS = SOLIDS | {name: slices(name) for name in ("small_crescent", "large_crescent")}


def table_i_ways(dome: Dome) -> list[Way]:
    """Press each object in the middle, 3 mm deep on a skin of 20 mm or as deep
    as the material law allows.
    """
    scale = dome.radius_mm / 20
    depth_mm = scale * min(DEPTH_MM, deepest_mm(dome))
    return [
        Way(name, Press(OBJECTS[name](), depth_mm=depth_mm, scale=scale)) for name in PAPER_OBJECTS
    ]


def third_family(
    states: Path, range_name: str = "working", sensors: int = 3
) -> Iterator[tuple[Calibration, list[Case]]]:
    """Calibrate each sensor on references, and picture its presses.

    Raises FileNotFoundError (not solved) and ConfigError.
    """
    for sensor in range(sensors):
        model, dome = drawn(range_name, sensor)
        draws = renderer(model, FIRST_SEED[range_name] + sensor)
        cases = []
        for k, way in enumerate(table_i_ways(dome)):
            kept = Kept.read(kept_file(states, range_name, sensor, WHAT, k))
            skin = deformed(dome.radius_mm, kept.rest_mm, kept.pressed_mm)
            truth = seen_truth(skin, (way.press,), model)
            image = draws.expose(draws.draw(skin), SCENE_NOISE + k)
            label = Label(f"third:{sensor}", way.object_name, depth_mm=way.press.depth_mm)
            cases.append(Case(label, KnownTruth.of(truth), image))
        yield calibrated(range_name, sensor), cases
