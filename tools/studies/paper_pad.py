"""The paper's Experiment 2: the touchpad of Fig. 7 from many presses, fused its way and ours.

::

    .venv/bin/python -m tools.studies.paper_pad [--step 5] [--profile paper accurate]

The default sensor, calibrated on 8 references and 40 ball presses, presses the whole pad; the map
is compared with the known surface. The paper judges its map by eye alone.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacshade_edge.cli.commands.simulate import write_pad
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.lab.studies.evaluate.work import PRESSES, REFERENCES, calibrated_sensor
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.lab.studies.stitch.map_presses import averaged, read_presses, stitcher_of
from tacshade_edge.lab.studies.stitch.map_truth import Score, read_known, score
from tacshade_edge.recording.frame_table import read_poses
from tacshade_edge.sensor.profiles import PROFILES

DEPTH_MM = 2.7
"""Depth of the apex below the highest bulge."""
STEP_MM = 5.0
EXACT = "exact"
TABLES = {EXACT: "POSES.csv", "noisy, 0.3 mm and 1°": "POSES_NOISY.csv"}


@dataclass(frozen=True, slots=True)
class Fused:
    """A map's score."""

    profile: str
    poses: str
    fusion: str
    score: Score


def rows(folder: Path, profiles: Sequence[str], step_mm: float) -> Iterator[Fused]:
    """Press the pad once, and fuse the presses of every profile by exact and noisy poses
    in both ways.
    """
    model = SensorModel()
    calibration = calibrated_sensor(SimulatedSensor(model), 0, REFERENCES, PRESSES).calibration
    with contextlib.redirect_stdout(io.StringIO()):  # the commands for a user
        write_pad(model, folder, step_mm, DEPTH_MM, seed=0)
    known = read_known(folder / "PAD.npz")
    posed = {poses: read_poses(folder / table) for poses, table in TABLES.items()}
    for profile in profiles:
        found = read_presses(calibration, PROFILES[profile], posed[EXACT], Progress())
        for poses, stated in posed.items():
            presses = [  # the sensor sits on the flange without an offset
                replace(press, base_T_sensor=at.base_T_flange)
                for press, at in zip(found, stated, strict=True)
            ]
            maps = {
                "mean": averaged(presses),
                "tiles": stitcher_of(presses, model.skin_radius_mm).finish(),
            }
            for fusion, made in maps.items():
                yield Fused(profile, poses, fusion, score(made.raster, known))


def text(found: Sequence[Fused]) -> str:
    """A line for each map."""
    head = ("method", "poses", "fusion", "RMS mm", "95 % mm", "bulges: RMS mm", "covered %")
    lines = [
        (
            each.profile,
            each.poses,
            each.fusion,
            f"{each.score.rms_mm:.3f}",
            f"{each.score.p95_mm:.3f}",
            f"{each.score.raised_rms_mm:.3f}",
            f"{100 * each.score.raised_coverage:.1f}",
        )
        for each in found
    ]
    return markdown(head, lines)


def main(words: Sequence[str] | None = None) -> int:
    """Run Experiment 2."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--step", type=float, default=STEP_MM, metavar="MM")
    parser.add_argument(
        "--profile",
        nargs="+",
        choices=list(PROFILES),
        default=["paper", "accurate"],
        metavar="NAME",
    )
    args = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as folder:
        print(text(list(rows(Path(folder), args.profile, args.step))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
