"""``simulate --pad``: a simulated robot presses all over the touchpad of the paper's Fig. 7."""

from __future__ import annotations

import csv
import functools
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.simulator import pad as pads
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.storage.tables.poses_table import HEADER
from tacshade_edge.studies.parallel import reported_map, workers

TRUTH_STEP_MM = 0.25
# Standard deviations of the noise in POSES_NOISY.csv: along each axis, and about a random one through the skin's apex.
NOISE_MM, NOISE_DEG = 0.3, 1.0
# Limits of `--pad-varied`: how much deeper or shallower, and how far tilted, a press may be.
VARIED_MM, VARIED_DEG = 0.4, 6.0


@dataclass(frozen=True, slots=True)
class _Task:
    model: SensorModel
    pose: tuple[float, ...]
    noise_seed: int


def write_pad(
    model: SensorModel,
    folder: Path,
    *,
    step_mm: float,
    depth_mm: float,
    varied: bool,
    seed: int,
    noise_seed: int,
    report: Callable[[str, int, int], None],
) -> None:
    """Write an image for each press, POSES.csv (exact), POSES_NOISY.csv and PAD.npz (the truth). Raises OSError."""
    pad, radius_mm = pads.touchpad(), model.skin_radius_mm
    if not 0.5 <= step_mm <= 20 or not 0 < depth_mm <= pads.MAX_DEPTH_MM:
        raise ConfigError(
            f"--pad-step, --pad-depth: found a step of {step_mm:g} mm and a depth of {depth_mm:g} mm, "
            f"expected a step of 0.5 to 20 mm and a depth above 0 and up to {pads.MAX_DEPTH_MM:g} mm"
        )
    poses = pads.scan(pad, step_mm, depth_mm, radius_mm)
    if varied:
        poses = pads.varied(poses, radius_mm, VARIED_MM, VARIED_DEG, seed)
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"press_{k:04d}.png" for k in range(len(poses))]
    tasks = [_Task(model, pose.seven(), noise_seed + k) for k, pose in enumerate(poses)]
    with workers() as pool:
        for name, data in zip(names, reported_map(_image, tasks, pool, report, "presses"), strict=True):
            (folder / name).write_bytes(data)
    noisy = pads.disturbed(poses, radius_mm, NOISE_MM, NOISE_DEG, seed)
    for name, stated in (("POSES.csv", poses), ("POSES_NOISY.csv", noisy)):
        _write_poses(folder / name, names, stated)
    (folder / "PAD.npz").write_bytes(_truth(pad))
    print(f"{folder}: {len(poses)} presses, POSES.csv, POSES_NOISY.csv, PAD.npz")


@functools.cache
def _sensor(model: SensorModel) -> SimulatedSensor:
    return SimulatedSensor(model)


def _image(task: _Task) -> bytes:
    """Return the image of a press as the bytes of a PNG file."""
    shape = pads.touchpad().under(from_seven(task.pose), task.model.skin_radius_mm)
    image = _sensor(task.model).frame((Press(shape, 0.0, 0.0, 0.0),), task.noise_seed).image
    return bytes(cv2.imencode(".png", image, (cv2.IMWRITE_PNG_COMPRESSION, 3))[1].tobytes())


def _write_poses(path: Path, names: Sequence[str], poses: Sequence[Rigid]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(HEADER)
        for name, pose in zip(names, poses, strict=True):
            # Sensor and flange coincide: the SENSOR.yaml of `--calibration-set` has no flange_T_sensor.
            writer.writerow((name, *(f"{v:.6f}" for v in pose.seven())))


def _truth(pad: pads.Pad) -> bytes:
    bars = [(b.x0_mm, b.y0_mm, b.x1_mm, b.y1_mm, b.width_mm) for b in pad.bulges if isinstance(b, pads.Bar)]
    arcs = [b for b in pad.bulges if isinstance(b, pads.Arc) and b.to_deg - b.from_deg >= 360]
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        z_mm=pads.raster(pad, TRUTH_STEP_MM),
        x0_mm=0.0,
        y0_mm=0.0,
        step_mm=TRUTH_STEP_MM,
        bars_mm=np.array(bars),
        circles_mm=np.array([(a.x_mm, a.y_mm, a.radius_mm, a.width_mm) for a in arcs]),
    )
    return buffer.getvalue()
