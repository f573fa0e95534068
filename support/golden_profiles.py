"""The golden presses: every object once, and what each profile makes of them;
pages of results stand on them.

After a change that is meant to move the figures::

    .venv/bin/python -m support.golden_profiles

writes tests/golden/profiles anew, a file for the simulator and each profile; look at the diff
before committing it. Pages of docs/results that have such a profile are stale then: see
tools/results.py.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from support.calibrated_sensor import HALF, simulated, step
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.simulator.truth import SimulatedFrame
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import Reconstruction

GOLDEN = Path(__file__).parents[1] / "tests/golden" / "profiles"
DEPTHS_MM = (1.0, 1.5, 2.0)
FARTHEST_MM = 2.5
SEED = 6100
FEW = 4
"""Of so many presses each, `paper` sees the first alone:
it takes as long as the others together.
"""


def presses() -> Iterator[tuple[str, SimulatedFrame]]:
    """Press every object at another place, turned; drag, twist and tilt every second."""
    for k, name in enumerate(OBJECTS):
        angle, moved = 2.4 * k, k % 2
        press = Press(
            OBJECTS[name](),
            x_mm=FARTHEST_MM * math.cos(angle),
            y_mm=FARTHEST_MM * math.sin(angle),
            depth_mm=DEPTHS_MM[k % len(DEPTHS_MM)],
            rotation_deg=40.0 * k,
            scale=0.5,
            tilt_x_deg=5.0 * moved,
            drag_x_mm=0.8 * moved * math.sin(angle),
            drag_y_mm=-0.8 * moved * math.cos(angle),
            twist_deg=6.0 * moved,
        )
        yield name, simulated(HALF).frame((press,), SEED + k)


Records = list[dict[str, Any]]


def figures() -> dict[str, Records]:
    """A record of each press: of the simulator, and of each profile's result."""
    records: dict[str, Records] = {name: [] for name in ("simulator", *PROFILES)}
    for k, (name, frame) in enumerate(presses()):
        image = {
            "mean": round(float(frame.image.mean()), 3),
            "spread": round(float(frame.image.std()), 3),
            "true_depth_mm": round(float(frame.skin.height_mm.max()), 4),
        }
        records["simulator"].append({"object": name, **image})
        for profile in PROFILES:
            if profile != "paper" or k % FEW == 0:
                result = step(profile, frame.image)
                records[profile].append({"object": name, **of_result(result)})
    return records


def of_result(result: Reconstruction) -> dict[str, Any]:
    """The figures of one result: counts exact, lengths in mm to four places."""
    seen = result.height.contact
    lengths = {
        "depth_mm": result.depth_max_mm,
        "height_mm": float(np.mean(result.height.height_mm[seen])) if seen.any() else 0.0,
        "sigma_mm": float(np.mean(result.sigma_mm[seen])) if result.sigma_mm is not None else 0.0,
    }
    lengths |= dict(
        zip(("shear_x_mm", "shear_y_mm"), result.shear_of_contact_mm or (), strict=False)
    )
    lengths |= dict(zip(("x_mm", "y_mm"), result.objects[0].centroid_mm, strict=False))
    whole = {"valid": result.valid, "objects": len(result.objects)}
    return whole | {"cells": int(seen.sum())} | {key: round(mm, 4) for key, mm in lengths.items()}


def regenerate() -> None:
    GOLDEN.mkdir(exist_ok=True)
    for name, records in figures().items():
        lines = ",\n".join(json.dumps(record) for record in records)
        (GOLDEN / f"{name}.json").write_text(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    regenerate()
