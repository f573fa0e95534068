#!/usr/bin/env python3
"""Maps of simulated surfaces, poses refined or not: is refinement worth it, and does it ever cost?

::

    .venv/bin/python -m tools.studies.stitch_pads [--pads shapes:1 relief:1] [--sensors default other:1] [--keep DIR]

Each sensor, calibrated on 40 ball presses, presses each surface (`drawn_pads.KINDS`, KIND:SEED) all over,
at varied depths and tilts. Its maps use exact poses and poses with Gaussian noise of several sizes: with refinement,
with the poses as reported, and by the paper's average. docs/results/stitching.md has the output. --keep stores the
reconstructions, so that the next run only stitches; delete them after a change of anything except stitching.
"""

from __future__ import annotations

import argparse
import functools
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.cli.shared import study
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.stitching.press_points import PressPoints, press_points
from tacshade_edge.core.stitching.stitcher import Stitcher
from tacshade_edge.core.stitching.surface_map import STEP_MM, Raster
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.simulator import pad as pads
from tacshade_edge.simulator.press import Press
from tacshade_edge.studies.evaluate.sensors import PressedSensor, calibrated, reconstructor
from tacshade_edge.studies.parallel import workers
from tacshade_edge.studies.stitch.average import radius_average
from tacshade_edge.studies.stitch.score import at_cells_of
from tacshade_edge.studies.stitch.work import AVERAGED_POINTS
from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import F32, Calibration, Frame
from tools.studies import command, drawn_pads
from tools.testbed.simulator.families import sensor_name

PADS = ("shapes:1", "shapes:2", "sparse:1", "relief:1", "relief:2")
SENSORS = ("default", "5", "11", "other:1", "other:2", "two-scales:3")
NOISES = ((0.0, 0.0), (0.1, 0.5), (0.3, 1.0), (0.5, 2.0))
"""Standard deviations of the reported poses: mm in every axis, degrees about a random axis through the apex."""
STEP_OF_SCAN_MM = 4.0
DEPTH_MM = 2.7  # of the tip below the highest place, in the mean
VARIED_MM, VARIED_DEG = 0.4, 6.0
TRUTH_STEP_MM = 0.25
_PRESS_NOISE = 600_000


@dataclass(frozen=True, slots=True)
class Task:
    """A surface and the sensor that presses it."""

    pad: str
    sensor: str
    profile: str
    keep: Path | None


@dataclass(frozen=True, slots=True)
class Line:
    """Maps of one surface, sensor and noise: RMS errors in mm.

    Attributes
    ----------
    moved : bool
        The stitcher did not take the poses as reported.
    refined_mm, reported_mm, average_mm : float
        With refinement, without, and of the paper's average; each over its own cells.
    shared_ratio : float
        `refined_mm` over `reported_mm`, both over the cells that the two maps share.
    left_out : int
        Presses that fitted nowhere.
    """

    noise: tuple[float, float]
    moved: bool
    refined_mm: float
    reported_mm: float
    average_mm: float
    shared_ratio: float
    left_out: int


def surface_of(name: str) -> pads.Surface:
    """A surface by KIND:SEED."""
    kind, _, seed = name.partition(":")
    return drawn_pads.KINDS[kind](int(seed or 0))


def presses_of(task: Task) -> tuple[list[Rigid], list[PressPoints], float]:
    """True poses of the presses that touched something, their points, and the skin's radius in mm."""
    kept = None if task.keep is None else task.keep / f"{task.pad}-{task.sensor}-{task.profile}.npz".replace(":", "_")
    if kept is not None and kept.exists():
        with np.load(kept) as npz:
            ends, radius_mm = npz["ends"][:-1], float(npz["radius_mm"])
            parts = [np.split(npz[name], ends) for name in ("points", "normals", "confidence")]
            return [from_seven(p) for p in npz["poses"]], [PressPoints(*p) for p in zip(*parts, strict=True)], radius_mm
    name = sensor_name(task.sensor)
    sensor, calibration, seed = name.make(), _calibration(task.sensor), int(task.pad.partition(":")[2] or 0)
    radius_mm = sensor.model.skin_radius_mm
    surface = surface_of(task.pad)
    poses = pads.scan(surface, STEP_OF_SCAN_MM, DEPTH_MM, radius_mm)
    poses = pads.varied(poses, radius_mm, VARIED_MM, VARIED_DEG, seed)
    poses, points = _reconstructed(surface, sensor, calibration, task.profile, poses)
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        np.savez(
            kept,
            ends=np.cumsum([len(p.points_mm) for p in points]),
            radius_mm=radius_mm,
            poses=[p.seven() for p in poses],
            points=np.concatenate([p.points_mm for p in points]),
            normals=np.concatenate([p.normals for p in points]),
            confidence=np.concatenate([p.confidence for p in points]),
        )
    return poses, points, radius_mm


@functools.cache
def _calibration(sensor: str) -> Calibration:
    return calibrated(sensor_name(sensor), 8, 40).calibration


def _reconstructed(
    surface: pads.Surface, sensor: PressedSensor, calibration: Calibration, profile: str, poses: list[Rigid]
) -> tuple[list[Rigid], list[PressPoints]]:
    made, touching, touched = reconstructor(calibration, profile), [], []
    for k, pose in enumerate(poses):
        press = Press(surface.under(pose, sensor.model.skin_radius_mm), 0.0, 0.0, 0.0)
        result = made.step(Frame(k, 0, 0, sensor.frame((press,), _PRESS_NOISE + k).image))
        points = press_points(result.height, calibration.geometry)
        if result.contact and len(points.points_mm):
            touching.append(pose)
            touched.append(points)
    return touching, touched


def lines_of(task: Task) -> list[Line]:
    """Every noise's line."""
    cv2.setNumThreads(1)
    poses, presses, radius_mm = presses_of(task)
    known = Raster(pads.raster(surface_of(task.pad), TRUTH_STEP_MM), 0, 0, TRUTH_STEP_MM)
    lines = []
    for k, noise in enumerate(NOISES):
        told = pads.disturbed(poses, radius_mm, *noise, seed=k) if noise[0] else poses
        stitcher, thin = Stitcher(radius_mm), []
        for points, pose in zip(presses, told, strict=True):
            stitcher.add(points, pose)
            thin.append(pose.apply(points.points_mm[:: -(-len(points.points_mm) // AVERAGED_POINTS)]))
        finished, reported = stitcher.finish(), stitcher.finish(None)
        average = radius_average(np.concatenate(thin), STEP_MM)
        errors = [at_cells_of(r, known) - known.z_mm for r in (finished.raster, reported.raster, average)]
        shared = np.isfinite(errors[0]) & np.isfinite(errors[1])
        ratio = rms(errors[0][shared]) / rms(errors[1][shared])
        out = sum(p.rejected is not None for p in finished.presses)
        refined_mm, reported_mm, average_mm = map(rms, errors)
        lines.append(Line(noise, finished.refined, refined_mm, reported_mm, average_mm, ratio, out))
    return lines


def rms(values: F32) -> float:
    """Root mean square of the known values."""
    return float(np.sqrt(np.nanmean(np.square(values, dtype=np.float64))))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pads", nargs="+", default=PADS, metavar="KIND:SEED")
    parser.add_argument("--sensors", nargs="+", default=SENSORS, metavar="NAME")
    parser.add_argument("--profile", choices=PROFILES, default="accurate")
    parser.add_argument("--keep", type=Path, metavar="DIR")
    study.add_cluster(parser)
    args = parser.parse_args()
    tasks = [Task(pad, sensor, args.profile, args.keep) for sensor in args.sensors for pad in args.pads]
    found, rows = [], []
    with command.folder_for(parser, args.keep), workers(args.cluster) as pool:
        made = list(pool.map(lines_of, tasks))
    for task, lines in zip(tasks, made, strict=True):
        found += lines
        for x in lines:
            figures = (f"{v:.3f}" for v in (x.refined_mm, x.reported_mm, x.average_mm))
            moved = "yes" if x.moved else "no"
            rows.append(
                (task.pad, task.sensor, told_noise(x.noise), *figures, f"{x.shared_ratio:.2f}", moved, str(x.left_out))
            )
    means = []
    for noise in NOISES:
        here = [x for x in found if x.noise == noise]
        figures = (f"{np.mean([getattr(x, n) for x in here]):.3f}" for n in ("refined_mm", "reported_mm", "average_mm"))
        ratios = [x.shared_ratio for x in here]
        worst = f"{np.mean(ratios):.2f}, {max(ratios):.2f}"
        means.append((told_noise(noise), *figures, worst, f"{sum(x.moved for x in here)} of {len(here)}"))
    columns = ("noise of the poses", "refined mm", "as reported mm", "paper's average mm")
    print(markdown((*columns, "refined over reported, shared cells: mean, worst", "moved"), means), end="\n\n")
    print(markdown(("surface", "sensor", *columns, "over reported, shared cells", "moved", "left out"), rows))


def told_noise(noise: tuple[float, float]) -> str:
    """The noise as text for a table."""
    return f"{noise[0]:g} mm, {noise[1]:g}°" if noise[0] else "none"


if __name__ == "__main__":
    main()
