#!/usr/bin/env python3
"""Write LABELS.csv for a recording of a robot that pressed the sensor on a flat, level box.

::

    .venv/bin/python -m tools.examples.servo.label_poses RECORDING --sensor SENSOR.yaml --top-mm 112.4

The recording has poses (docs/replay.md). `--top-mm` is the z of the box's top in the robot's base frame, whose z goes
up: that of the sensor's tip when the upright sensor first touches the box.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from pathlib import Path

import yaml

from tacshade_edge.rigid import Rigid, from_seven

COLUMNS = ("image", "depth_mm", "tilt_x_deg", "tilt_y_deg", "group")
POSE = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
LEAST_MM = 0.2
"""Shallower frames are left out: who knows the box's height to less?"""


def label(base_T_sensor: Rigid, skin_radius_mm: float, top_mm: float) -> tuple[float, float, float]:
    """Depth along the box's normal, and the box's tilt about the sensor's x, then y."""
    n_x, n_y, n_z = (-base_T_sensor.rotation[2]).tolist()  # the way down, in the sensor's frame
    depth_mm = skin_radius_mm - (float(base_T_sensor.translation_mm[2]) - top_mm)
    return depth_mm, -math.degrees(math.asin(n_y)), math.degrees(math.atan2(n_x, n_z))


def labelled(recording: Path, sensor: Path, top_mm: float) -> list[tuple[str, ...]]:
    """A row of `COLUMNS` for each frame in contact; frames between two that are free are one press."""
    stated = yaml.safe_load(sensor.read_text(encoding="utf-8"))
    flange_T_sensor = from_seven(stated.get("flange_T_sensor", (0, 0, 0, 1, 0, 0, 0)))
    rows, press, was_free = [], 0, True
    with (recording / "frames.csv").open(encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            if not row["qw"]:
                continue
            base_T_sensor = from_seven([float(row[name]) for name in POSE]) @ flange_T_sensor
            depth_mm, *tilt_deg = label(base_T_sensor, stated["skin_radius_mm"], top_mm)
            is_free = depth_mm < LEAST_MM
            if not is_free:
                press += was_free
                rows.append((row["image"], *(f"{value:.4f}" for value in (depth_mm, *tilt_deg)), str(press)))
            was_free = is_free
    return rows


def main() -> int:
    """Write the table into the recording's folder."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("--sensor", type=Path, required=True, metavar="SENSOR.yaml")
    parser.add_argument("--top-mm", type=float, required=True)
    parser.add_argument("--count", type=int, default=400, help="most rows, evenly taken")
    args = parser.parse_args()
    try:
        rows = labelled(args.recording, args.sensor, args.top_mm)
    except (OSError, KeyError, ValueError) as error:
        print(f"label_poses: {error}", file=sys.stderr)
        return 1
    kept = rows[:: math.ceil(len(rows) / args.count)] if rows else []
    table = args.recording / "LABELS.csv"
    with table.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream).writerows((COLUMNS, *kept))
    print(f"{table}: {len(kept)} of {len(rows)} frames in contact, {rows[-1][-1] if rows else 0} presses")
    return 0


if __name__ == "__main__":
    sys.exit(main())
