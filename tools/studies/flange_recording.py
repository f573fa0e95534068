"""Run `stitch --find-flange` on a recording of a simulated robot that follows the plan with a clock of its own.

::

    .venv/bin/python -m tools.studies.flange_recording [--sensor 5] [--profile accurate] [--seed 0]

The robot starts 10 mm and 10° off, presses a wavy surface 100 times (docs/how-to/stitching.md), and moves down and
up at 10 mm/s. Every frame is drawn, and stamped later than the robot's poses, which are off by 0.2 mm and 0.2°.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.rigid import from_seven, shift
from tacshade_edge.simulator.pad import disturbed
from tacshade_edge.simulator.press import Press
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.studies.evaluate.sensors import calibrated
from tacshade_edge.types import U8, Calibration
from tools.studies import drawn_pads, flange
from tools.testbed import flange_plan
from tools.testbed.simulator.families import sensor_name

DELAY_S, PERIOD_S, TAKES_S, DEPTH_MM = 0.035, 0.05, 3.0, 2.0
NOISE = (0.2, 0.2)
_SPAN = round((flange_plan.PAUSE_S / 2 + flange_plan.LIFT_MM / flange_plan.SPEED_MM_S) / PERIOD_S)
_HEADER = "image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz"


def write_recording(
    path: Path,
    picture: Callable[[tuple[Press, ...], int], U8],
    calibration: Calibration,
    presses: int = 100,
    turns: flange_plan.Turns = flange_plan.TURNS_DEG,
    noise: tuple[float, float] = NOISE,
    seed: int = 0,
) -> None:
    """Write the plan's first presses, and ``cal.npz`` with the flange pose that the robot believes.

    Parameters
    ----------
    picture : callable
        Takes the presses and a seed of the noise.
    noise : (float, float)
        Noise of the reported poses, in mm and degrees.
    """
    path.mkdir(parents=True)
    start, radius_mm = flange.start_of(seed), calibration.geometry.skin_radius_mm
    placed = replace(calibration, flange_T_sensor=tuple(start.seven()))
    calibration_file.save(path / "cal.npz", calibration_file.with_crc(placed))
    cv2.imwrite(str(path / "free.png"), picture((), seed))
    surface = drawn_pads.KINDS["relief"](1 + seed)
    plan = flange_plan.plan(surface.width_mm / 2, surface.length_mm / 2, radius_mm, turns)[:presses]
    true = [flange.lowered(pose @ start.inverse() @ flange.TRUE, radius_mm, surface, DEPTH_MM) for pose in plan]
    reported = [pose @ flange.TRUE.inverse() for pose in disturbed(true, radius_mm, *noise, seed=seed)]
    rows = [_HEADER]
    for k, (base_T_sensor, base_T_flange) in enumerate(zip(true, reported, strict=True)):
        for t_s in (PERIOD_S * np.arange(-_SPAN, _SPAN + 1)).tolist():
            above_mm, name = flange_plan.height_mm(t_s), "free.png"
            if above_mm < DEPTH_MM:
                name = f"{k:03}-{above_mm:.3f}.png"
                if not (path / name).exists():
                    shape = surface.under(shift(0, 0, above_mm) @ base_T_sensor, radius_mm)
                    cv2.imwrite(str(path / name), picture((Press(shape, 0.0, 0.0, 0.0),), 10 * k))
            stamp_s = t_s + DELAY_S
            pose = shift(0, 0, flange_plan.height_mm(stamp_s)) @ base_T_flange
            t_ns = round(1e9 * (1 + k * TAKES_S + stamp_s))
            rows.append(",".join((name, str(t_ns), *(f"{value:.9f}" for value in pose.seven()))))
    (path / "frames.csv").write_text("\n".join(rows) + "\n")


def main() -> None:
    """Record, run the command and compare."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sensor", default="5")
    parser.add_argument("--profile", choices=PROFILES, default="accurate")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    name = sensor_name(args.sensor)
    sensor, calibration = name.make(), calibrated(name, 8, 40).calibration
    with tempfile.TemporaryDirectory() as folder:
        recording, out = Path(folder) / "recording", Path(folder) / "out"
        write_recording(recording, lambda pressed, seed: sensor.frame(pressed, seed).image, calibration, seed=args.seed)
        words = ["stitch", "--find-flange", "--calibration", str(recording / "cal.npz"), "--profile", args.profile]
        words += ["--recording", str(recording), "--out", str(out)]
        subprocess.run([sys.executable, "-m", "tacshade_edge", *words], check=True)
        about = json.loads((out / "flange.json").read_text())
    found = from_seven(about["flange_T_sensor"])
    off_mm = float(np.linalg.norm(found.translation_mm - flange.TRUE.translation_mm))
    turned, _ = cv2.Rodrigues(found.rotation @ flange.TRUE.rotation.T)
    off_ms = about["delay_ms"] - 1000 * DELAY_S
    print(f"off by {off_mm:.2f} mm, {np.degrees(np.linalg.norm(turned)):.2f} degrees, {off_ms:+.1f} ms")


if __name__ == "__main__":
    main()
