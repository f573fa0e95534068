"""Show that a finer mesh changes little: solve the same paths on coarser and finer meshes and compare them.

::

    nice PYTHON -m tools.studies.third_family.mesh_check [--edges-mm 1.3,1.0] [--ways 3]

PYTHON must have MuJoCo (requirements.txt). Each mesh is compared with the finest on the skin's grid: heights and
shears in the finest mesh's contact, and heights where its skirt is deeper than 0.1 mm.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

import numpy as np

from tacshade_edge.simulator.press import Press, distance_mm
from tacshade_edge.simulator.skin import Skin, node_directions
from tools.studies.third_family.dome import FIRST_SEED, drawn
from tools.studies.third_family.paths import ways
from tools.studies.third_family.seen import TOUCHING_MM, deformed


def compared(fine: Skin, coarse: Skin, press: Press) -> tuple[float, float, float, float]:
    """Compute differences in mm: median and 95 % quantile of h in contact, its median in the skirt, median of shear."""
    points = node_directions(fine.radius_mm).astype(np.float64) * (fine.radius_mm - fine.height_mm)[..., None]
    distance = distance_mm((press,), fine.radius_mm, points.reshape(-1, 3)).reshape(fine.height_mm.shape)
    contact = distance <= TOUCHING_MM
    beside = (fine.height_mm > 0.1) & ~contact
    off = np.abs(fine.height_mm - coarse.height_mm)
    moved = np.linalg.norm(np.asarray(fine.origin_mm) - np.asarray(coarse.origin_mm), axis=-1)
    return (
        float(np.median(off[contact])), float(np.percentile(off[contact], 95)), float(np.median(off[beside])),
        float(np.median(moved[contact])),
    )  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Solve each path on each mesh and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--edges-mm", default="1.3,1.0", help="at the tip of a skin of 20 mm; the finest last")
    parser.add_argument("--gel-layers", default="3,4", help="for each of them")
    parser.add_argument("--ways", type=int, default=3)
    options = parser.parse_args(arguments)
    from tools.studies.third_family.solve import solved

    meshes = list(zip(map(float, options.edges_mm.split(",")), map(int, options.gel_layers.split(",")), strict=True))
    print("| object | skin | edge mm | layers | CPU s | penetration mm "
          "| h in contact, median mm | 95 % mm | h beside, median mm | shear, median mm |")  # fmt: skip
    print("|---|---|--:|--:|--:|--:|--:|--:|--:|--:|")
    for sensor in range(options.ways):
        _, dome = drawn("working", sensor)
        way = ways(dome, FIRST_SEED["working"] + sensor, 1)[0]
        skins: dict[str, Any] = {}
        for edge_mm, layers in reversed(meshes):
            start = time.process_time()
            rest, *states = solved(dome, way, edge_mm, layers)
            took = time.process_time() - start
            for what, state, press in zip(
                ("pressed", "dragged"), states, (way.pressed(dome.radius_mm), way.press), strict=True
            ):
                skin = deformed(dome.radius_mm, rest, state.at_mm)
                fine = skins.setdefault(what, skin)
                off = " | ".join(["-"] * 4 if fine is skin else [f"{v:.3f}" for v in compared(fine, skin, press)])
                print(f"| {way.object_name} | {what} | {edge_mm:g} | {layers + 1} | {took:.0f} | "
                      f"{state.penetration_mm:.3f} | {off} |", flush=True)  # fmt: skip
    return 0


if __name__ == "__main__":
    sys.exit(main())
