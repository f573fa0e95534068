#!/usr/bin/env python3
"""How well `stitch --find-flange` finds the sensor on the flange and the delay of its frames, on simulated presses.

::

    .venv/bin/python -m tools.studies.flange [--trials 20] [--start 10 10] [--profile accurate] [--final] [--keep DIR]

Each trial has a surface, a sensor calibrated on 40 ball presses, a true place on the flange, a delay, and a start that
is 10 mm and 10 degrees off. A robot that believes the start follows the plan of stitching.md: it turns and moves where
the plan says, then down until the sensor is deep enough in the surface. Every fifth press has frames of the motion down
and up. Every image is drawn and reconstructed. The reported poses have Gaussian noise, drawn once for each press.
`--start 0.5 0.5` is for repeating the plan with the result. --keep stores the reconstructions; delete them after a
change of anything except the code that finds the flange.
"""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.stitching.flange import ORDER, FoundFlange, find_flange
from tacshade_edge.core.stitching.flange_equations import ContactFrame
from tacshade_edge.core.stitching.flange_motions import unseen
from tacshade_edge.core.stitching.press_points import press_points
from tacshade_edge.core.stitching.refinement import thin_points
from tacshade_edge.rigid import Rigid, from_seven, shift, turn
from tacshade_edge.simulator import pad as pads
from tacshade_edge.simulator.press import Press
from tacshade_edge.studies.evaluate.sensors import calibrated, reconstructor
from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import F64, Calibration, Frame, Pose
from tools.studies import drawn_pads
from tools.testbed import flange_plan
from tools.testbed.simulator.families import sensor_name

SENSORS = ("default", "5", "11", "other:1", "two-scales:3")
FINAL = ("9021", "9022", "9023", "other:9021", "two-scales:9021")
"""Sensors kept for final figures."""
PADS = ("relief:1", "relief:2", "relief:3", "touchpad:0")
NOISES = ((0.1, 0.1), (0.2, 0.2), (0.3, 0.3))
"""Standard deviations of the reported poses: mm in every axis, degrees about a random axis through the apex."""
START = (10.0, 10.0)
"""Error of the believed start, in mm and degrees."""
TRUE = shift(12, -7, 55) @ turn((0.3, -0.2, 1.1))
WITHIN_MM, WITHIN_DEG, WITHIN_MS, WITHIN_SIGMAS = 0.5, 0.7, 5.0, 2.5
_DEPTH_MM, _VARIED_MM = 2.0, 0.4
_MOVING_MM = (-1.2, -0.6, 0.6, 1.2)  # above the press: on the way down, then up
_DELAY_MS = (-40.0, 60.0)
_PRESS_NOISE = 700_000


@dataclass(frozen=True, slots=True)
class Task:
    """A trial's presses; `constant` keeps one orientation."""

    trial: int
    profile: str
    keep: Path | None
    start: tuple[float, float] = START
    constant: bool = False
    sensors: tuple[str, ...] = SENSORS

    @property
    def sensor(self) -> str:
        """The sensor's name."""
        return self.sensors[self.trial % len(self.sensors)]

    @property
    def pad(self) -> str:
        """The surface as KIND:SEED."""
        return PADS[self.trial // len(self.sensors) % len(PADS)]


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """Reconstructed frames: each one's thinned points, true pose, press, and distance above that press."""

    points: list[F64]
    base_T_sensor: list[Rigid]
    press: list[int]
    above_mm: list[float]
    radius_mm: float


def start_of(trial: int, off: tuple[float, float] = START) -> Rigid:
    """The pose that the robot believes, off by the given mm and degrees."""
    rng = np.random.default_rng((trial, 31))
    axis, way = rng.standard_normal(3), rng.standard_normal(3)
    rotation = turn(axis / np.linalg.norm(axis) * math.radians(off[1])).rotation @ TRUE.rotation
    return Rigid(rotation, TRUE.translation_mm + way / np.linalg.norm(way) * off[0])


@functools.cache
def _calibration(sensor: str) -> Calibration:
    return calibrated(sensor_name(sensor), 8, 40).calibration


def lowered(pose: Rigid, radius_mm: float, surface: pads.Surface, depth_mm: float) -> Rigid:
    """Lower a pose along the base's z until the undeformed skin is `depth_mm` deep in the surface."""
    dx, dy = np.meshgrid(*(np.linspace(-0.8, 0.8, 81) * radius_mm,) * 2)
    dome = np.sqrt(np.maximum(radius_mm**2 - dx**2 - dy**2, 0))
    inside = dome > 0.6 * radius_mm
    x, y, z = pose.translation_mm
    reaches = surface.height_mm(x + dx[inside], y + dy[inside]) + dome[inside]
    return shift(0, 0, float(reaches.max() - depth_mm - z)) @ pose


def taken(task: Task) -> Taken:
    """All frames of the plan in contact."""
    name = f"{task.trial}-{task.pad}-{task.sensor}-{task.profile}-{task.constant}-{task.start}.npz".replace(":", "_")
    kept = None if task.keep is None else task.keep / name
    if kept is not None and kept.exists():
        with np.load(kept) as npz:
            parts, poses = np.split(npz["points"], npz["ends"][:-1]), [from_seven(p) for p in npz["true"]]
            return Taken(parts, poses, npz["press"].tolist(), npz["above"].tolist(), float(npz["radius"]))
    sensor, calibration = sensor_name(task.sensor).make(), _calibration(task.sensor)
    radius_mm, made = sensor.model.skin_radius_mm, reconstructor(calibration, task.profile)
    kind, _, seed = task.pad.partition(":")
    surface = drawn_pads.KINDS[kind](int(seed))
    rng = np.random.default_rng((task.trial, 32))
    turns = (((0, 0, 0),) * 5,) if task.constant else flange_plan.TURNS_DEG
    believed = flange_plan.plan(surface.width_mm / 2, surface.length_mm / 2, radius_mm, turns)
    out = Taken([], [], [], [], radius_mm)
    for k, pose in enumerate(believed):
        true = pose @ start_of(task.trial, task.start).inverse() @ TRUE
        true = lowered(true, radius_mm, surface, _DEPTH_MM + float(rng.uniform(-_VARIED_MM, _VARIED_MM)))
        moving = _MOVING_MM if k % 5 == k // 5 % 5 else ()
        for above_mm in (0.0, *moving):
            at, seq = shift(0, 0, abs(above_mm)) @ true, len(out.press)
            press = Press(surface.under(at, radius_mm), 0.0, 0.0, 0.0)
            image = sensor.frame((press,), _PRESS_NOISE + 10 * k + seq).image
            result = made.step(Frame(seq, 0, 0, image))
            points = thin_points(press_points(result.height, calibration.geometry))
            if result.contact and len(points):
                out.points.append(points)
                out.base_T_sensor.append(at)
                out.press.append(k)
                out.above_mm.append(above_mm)
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        np.savez(
            kept,
            points=np.concatenate(out.points),
            ends=np.cumsum([len(p) for p in out.points]),
            true=[pose.seven() for pose in out.base_T_sensor],
            press=out.press,
            above=out.above_mm,
            radius=radius_mm,
        )
    return out


def frames_of(got: Taken, noise: tuple[float, float], delay_ms: float, seed: int) -> list[ContactFrame]:
    """The frames with the robot's reported poses and late time stamps."""
    rest = [shift(0, 0, -abs(above)) @ pose for pose, above in zip(got.base_T_sensor, got.above_mm, strict=True)]
    first = {press: k for k, press in reversed(list(enumerate(got.press)))}
    noisy = pads.disturbed([rest[first[press]] for press in sorted(first)], got.radius_mm, *noise, seed=seed)
    flanges = {press: pose @ TRUE.inverse() for press, pose in zip(sorted(first), noisy, strict=True)}
    numbers = {press: k for k, press in enumerate(sorted(first))}
    frames = []
    for press, above_mm, points in zip(got.press, got.above_mm, got.points, strict=True):
        if above_mm:
            t_ns = flange_plan.MIDDLE_NS + round(flange_plan.time_s(above_mm) * 1e9 + delay_ms * 1e6)
            frames.append(ContactFrame(points, numbers[press], t_ns, flange_plan.track(flanges[press], press % 7 / 7)))
        else:
            frames.append(ContactFrame(points, numbers[press], 0, (Pose(0, *flanges[press].seven()),)))
    return frames


def errors(found: FoundFlange, delay_ms: float) -> F64:
    """Errors in the order and units of `ORDER`."""
    turned, _ = cv2.Rodrigues(found.flange_T_sensor.rotation @ TRUE.rotation.T)
    moved_mm = found.flange_T_sensor.translation_mm - TRUE.translation_mm
    return np.concatenate((moved_mm, np.degrees(turned.ravel()), (found.delay_ms - delay_ms,)))


def row(noise: tuple[float, float], found: Sequence[tuple[F64, F64]]) -> tuple[str, ...]:
    """A table line with the errors and standard deviations of many trials."""
    off, sigma = np.stack([e for e, _ in found]), np.stack([s for _, s in found])
    mm, deg, ms = np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:6], axis=1), np.abs(off[:, 6])
    within = (np.abs(off) <= WITHIN_SIGMAS * sigma).mean()
    columns = [f"{noise[0]:g} mm, {noise[1]:g}°"]
    for values, limit in ((mm, WITHIN_MM), (deg, WITHIN_DEG), (ms, WITHIN_MS)):
        columns.append(f"{np.median(values):.2f}, {values.max():.2f}; {(values <= limit).sum()} of {len(values)}")
    return (*columns, f"{100 * within:.0f} %", f"{np.sqrt(np.mean((off / sigma) ** 2)):.2f}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--start", type=float, nargs=2, default=START, metavar=("MM", "DEG"), help="how far off it is")
    parser.add_argument("--profile", choices=PROFILES, default="accurate")
    parser.add_argument("--final", dest="sensors", action="store_const", const=FINAL, default=SENSORS)
    parser.add_argument("--keep", type=Path, metavar="DIR")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    off_by: tuple[float, float] = (args.start[0], args.start[1])
    found: dict[tuple[float, float], list[tuple[F64, F64]]] = {noise: [] for noise in NOISES}
    rows = []
    for trial in range(args.trials):
        task = Task(trial, args.profile, args.keep, off_by, sensors=args.sensors)
        got = taken(task)
        delay_ms = float(np.random.default_rng((trial, 33)).uniform(*_DELAY_MS))
        for noise in NOISES:
            result = find_flange(frames_of(got, noise, delay_ms, trial), start_of(trial, off_by), got.radius_mm)
            off, sigma = errors(result, delay_ms), np.sqrt(np.diag(result.covariance))
            found[noise].append((off, sigma))
            each = (f"{e:.2f} ({s:.2f})" for e, s in zip(off, sigma, strict=True))
            rows.append((task.pad, task.sensor, f"{noise[0]:g} mm, {noise[1]:g}°", *each))
    limits = (f"mm: median, worst; within {WITHIN_MM}", f"degrees; within {WITHIN_DEG}", f"ms; within {WITHIN_MS:g}")
    columns = ("noise of the poses", *limits, f"within {WITHIN_SIGMAS} standard deviations", "RMS in those")
    print(markdown(columns, [row(noise, here) for noise, here in found.items()]), end="\n\n")
    print(markdown(("surface", "sensor", "noise", *ORDER), rows), end="\n\n")
    got = taken(Task(0, args.profile, args.keep, off_by, constant=True, sensors=args.sensors))
    frames = frames_of(got, NOISES[1], 0.0, 0)
    print(
        "one orientation:", unseen(frames, start_of(0, off_by), find_flange(frames, start_of(0, off_by), got.radius_mm))
    )


if __name__ == "__main__":
    main()
