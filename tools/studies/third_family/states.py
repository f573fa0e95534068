"""Solve the mechanics of a range's sensors, which is slow, and store a file for each object's path.

::

    nice PYTHON -m tools.studies.third_family.states --range working --sensors 6 --ways 6 --out FOLDER

PYTHON must have MuJoCo (requirements.txt). Existing files in FOLDER stay as they are.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tacshade_edge.types import F64
from tools.studies.third_family.dome import FIRST_SEED, RANGES, drawn
from tools.studies.third_family.paths import ways

if TYPE_CHECKING:
    from tools.studies.third_family.solve import State


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """The stored states of a path.

    Attributes
    ----------
    rest_mm, pressed_mm, dragged_mm : float64 (N, 3)
        The skin's points without an object, pressed, and dragged.
    penetration_mm, stirring_mm : float64 (2,)
        The same as in `solve.State`, pressed and dragged.
    """

    rest_mm: F64
    pressed_mm: F64
    dragged_mm: F64
    penetration_mm: F64
    stirring_mm: F64


def kept_file(folder: Path, range_name: str, sensor: int, way: int) -> Path:
    """Return the file of a path's states."""
    return folder / f"{range_name}-{sensor}-{way}.npz"


def read(path: Path) -> Kept:
    """Read a path's states. Raises FileNotFoundError."""
    with np.load(path) as file:
        return Kept(**{name: file[name] for name in Kept.__slots__})


def keep(path: Path, rest: F64, pressed: State, dragged: State) -> None:
    """Write a path's states, completely or not at all."""
    part = path.with_suffix(".part.npz")
    np.savez_compressed(
        part, rest_mm=rest, pressed_mm=pressed.at_mm, dragged_mm=dragged.at_mm,
        penetration_mm=np.array((pressed.penetration_mm, dragged.penetration_mm)),
        stirring_mm=np.array((pressed.stirring_mm, dragged.stirring_mm)),
    )  # fmt: skip
    os.replace(part, path)


def solve_all(range_name: str, sensors: int, count: int, folder: Path) -> None:
    """Solve the missing paths."""
    from tools.studies.third_family.solve import solved

    folder.mkdir(parents=True, exist_ok=True)
    for k in range(count):
        for sensor in range(sensors):
            _, dome = drawn(range_name, sensor)
            way = ways(dome, FIRST_SEED[range_name] + sensor, count)[k]
            path = kept_file(folder, range_name, sensor, k)
            if path.exists():
                continue
            keep(path, *solved(dome, way))
            print(f"sensor {sensor}, way {k}: {way.object_name}", flush=True)


def main(arguments: list[str] | None = None) -> int:
    """Solve the missing paths of a range."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--range", choices=RANGES, default="working")
    parser.add_argument("--sensors", type=int, default=6)
    parser.add_argument("--ways", type=int, default=6, help="objects on each sensor, two states each")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args(arguments)
    solve_all(options.range, options.sensors, options.ways, options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
