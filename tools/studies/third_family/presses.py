"""Presses for a calibration: balls of three sizes, flat ends of two and a square, with the errors that users make.

::

    nice ENGINE/bin/python -m tools.studies.third_family.presses --range working --sensors 6 --count 40 --states FOLDER

solves the missing ones, which is slow and needs MuJoCo (requirements.txt).
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacshade_edge.core.calibration.indenters import indenter
from tacshade_edge.core.calibration.indenters.indenter import Indenter
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.studies.evaluate.sensors import PRESS_NOISE
from tools.studies.third_family.dome import FIRST_SEED, RANGES, Dome, drawn
from tools.studies.third_family.paths import Way, deepest_mm
from tools.studies.third_family.seen import deformed, renderer
from tools.studies.third_family.states import keep, read
from tools.testbed.stated_press import stated_press

SIZES_MM: dict[str, float] = {"ball": 6.0, "cylinder": 5.0, "cube": 10.0}
"""Radius of the ball and the cylinder, and side of the cube, of `paths.SOLIDS`."""
KINDS = (("ball", 3.0), ("cylinder", 2.5), ("ball", 4.5), ("cube", 6.0), ("ball", 7.0), ("cylinder", 4.0))
"""Object and its radius or side in mm on a skin of 20 mm; the presses take them in turn."""
SHALLOWEST_MM = 0.6
REACH_RADII = 0.4
"""Greatest distance of a press from the tip: beyond, the mesh is coarse."""


def known_ways(dome: Dome, seed: int, count: int) -> list[Way]:
    """Draw presses without drag, twist or tilt."""
    rng = np.random.default_rng((seed, 44))
    scale, made = dome.radius_mm / 20, []
    for k in range(count):
        name, size_mm = KINDS[k % len(KINDS)]
        rho, angle = REACH_RADII * dome.radius_mm * math.sqrt(rng.random()), rng.uniform(0, 2 * math.pi)
        depth_mm, turn_deg = rng.uniform((SHALLOWEST_MM, 0), (deepest_mm(dome), 360))
        x_mm, y_mm = rho * math.cos(angle), rho * math.sin(angle)
        enlarged = scale * size_mm / SIZES_MM[name]
        made.append(Way(name, Press(OBJECTS[name](), x_mm, y_mm, depth_mm * scale, turn_deg, enlarged)))
    return made


def kept_file(folder: Path, range_name: str, sensor: int, number: int) -> Path:
    """Return the file of a press's states."""
    return folder / f"{range_name}-{sensor}-press-{number}.npz"


def described(way: Way) -> tuple[float, Indenter | None]:
    """Return the ball's radius in mm (0 for others) and the user's description of others."""
    size_mm = SIZES_MM[way.object_name] * way.press.scale
    if way.object_name == "ball":
        return size_mm, None
    if way.object_name == "cube":
        return 0.0, indenter.box(f"square {size_mm:.1f}", size_mm, size_mm)
    return 0.0, indenter.cylinder(f"flat {2 * size_mm:.1f}", size_mm)


def known_presses(range_name: str, sensor: int, count: int, folder: Path) -> Sequence[KnownPress]:
    """Draw the stored presses of a sensor, with errors in the stated places and depths.

    Raises
    ------
    FileNotFoundError
        A press has not been solved.
    """
    model, dome = drawn(range_name, sensor)
    seed = FIRST_SEED[range_name] + sensor
    draws, rng = renderer(model, seed), np.random.default_rng((seed, 45))
    made = []
    for k, way in enumerate(known_ways(dome, seed, count)):
        kept = read(kept_file(folder, range_name, sensor, k))
        image = draws.expose(draws.draw(deformed(dome.radius_mm, kept.rest_mm, kept.pressed_mm)), PRESS_NOISE + k)
        made.append(stated_press(rng, f"press {k}", image, way.press, *described(way)))
    return made


def main(arguments: list[str] | None = None) -> int:
    """Solve the missing presses of a range."""
    from tools.studies.third_family.solve import solved

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--range", choices=RANGES, default="working")
    parser.add_argument("--sensors", type=int, default=6)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--states", type=Path, required=True)
    options = parser.parse_args(arguments)
    options.states.mkdir(parents=True, exist_ok=True)
    for sensor in range(options.sensors):
        _, dome = drawn(options.range, sensor)
        for k, way in enumerate(known_ways(dome, FIRST_SEED[options.range] + sensor, options.count)):
            if not (path := kept_file(options.states, options.range, sensor, k)).exists():
                keep(path, *solved(dome, way))
                print(f"sensor {sensor}, press {k}: {way.object_name}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
