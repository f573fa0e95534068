"""The golden replay: 200 small simulated frames,
and what the pipeline made of them when it was last looked at.

After a change that is meant to move the figures::

    .venv/bin/python -m support.golden_replay

writes tests/golden/replay.json anew; look at its diff before committing it.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from support.calibrated_sensor import HALF, calibrated, simulated
from support.recordings import write_recording
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.cli import main
from tacshade_edge.lab.simulator.script import Script, demonstration

GOLDEN = Path(__file__).parents[1] / "tests/golden" / "replay.json"
FRAMES = 200
SEED = 5000  # none of the calibration's images has one of these
SCRIPT = Script(
    tuple(replace(press, depth_mm=2.5) for press in demonstration().presses),
    approach=5,
    hold=6,
    release=5,
    pause=4,
)


def write_input(folder: Path, frames: int = FRAMES) -> list[str]:
    """Write calibration and recording; the words of `replay` for them."""
    calibration_file.save(folder / "cal.npz", calibrated())
    images = [simulated(HALF).frame(SCRIPT.at(k), SEED + k).image for k in range(frames)]
    write_recording(folder / "rec", images, period_ns=33_333_333)
    return ["replay", str(folder / "rec"), "--calibration", str(folder / "cal.npz")]


def figures(run: Path) -> list[dict[str, Any]]:
    """Per frame: contact, depth, number of objects, and the centroid of the greatest."""
    return [
        {
            "contact": record["contact"],
            "depth_max_mm": record["depth_max_mm"],
            "objects": len(record["objects"]),
            "centroid_mm": record["objects"][0]["centroid_mm"] if record["objects"] else None,
        }
        for record in json.loads((run / "summary.json").read_text())
    ]


def regenerate() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        assert main([*write_input(folder), "--out", str(folder / "run")]) == 0
        lines = ",\n".join(json.dumps(record) for record in figures(folder / "run"))
    GOLDEN.write_text(f"[\n{lines}\n]\n")


if __name__ == "__main__":
    regenerate()
