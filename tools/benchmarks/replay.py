"""Replay a recording in two processes: are the bytes the same, and how much faster than real time is it?

::

    .venv/bin/python -m tools.benchmarks.replay [--frames 1000] [--fps 30] [--profile fast]

The recording shows the simulated sensor in 640x480 grey, like a camera's; each frame has its own noise, and every other
frame a pose. The exit code is 1 if a byte differs.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.demo.sensor import make_calibration
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.simulator.script import demonstration
from tacshade_edge.storage.recording.recorder import Recorder, png_of
from tacshade_edge.storage.runs.run_files import CLOUDS, HEIGHTS, SUMMARY
from tacshade_edge.types import Frame, Pose

DRAWN = 48  # drawing costs more than replaying: these frames repeat with different noise
NOISE_GREY = 2.0


def write_recording(folder: Path, frames: int, fps: float) -> None:
    """Write `frames` different images and the calibration."""
    sensor, script = SimulatedSensor(), demonstration()
    drawn = [sensor.frame(script.at(5 * k), noise_seed=k).image[:, :, 1].astype(np.float32) for k in range(DRAWN)]
    noise = np.random.default_rng(1)
    recorder = Recorder(folder, free_floor_bytes=0)
    recorder.begin("", make_calibration())
    for k in range(frames):
        grey = drawn[k % DRAWN] + NOISE_GREY * noise.standard_normal(drawn[0].shape, dtype=np.float32)
        t_ns = 10**9 + round(k * 1e9 / fps)
        pose = Pose(t_ns, 0.1 * k, -3.0, 40.0, 1.0, 0.0, 0.0, 0.0) if k % 2 else None
        image = np.clip(grey, 0, 255).astype(np.uint8)
        recorder.add(Frame(k, t_ns, 0, image, pose), png_of(image))
    recorder.finish({"frames": frames})


def main() -> int:
    """Write the recording, replay it twice and compare."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--profile", choices=list(PROFILES), default="fast")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_recording(folder / "rec", args.frames, args.fps)
        words = [sys.executable, "-m", "tacshade_edge", "replay", "rec", "--profile", args.profile]
        for run in ("a", "b"):
            given = [*words, "--calibration", "rec/calibration.npz", "--out", run]
            print(subprocess.run(given, cwd=folder, check=True, stdout=subprocess.PIPE, text=True).stdout, end="")
        same = True
        for file in (HEIGHTS, CLOUDS, SUMMARY):
            first, second = ((folder / run / file).read_bytes() for run in ("a", "b"))
            same = same and first == second
            print(f"{file}: {len(first)} bytes, {'the same' if first == second else 'DIFFERENT'} in both processes")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
