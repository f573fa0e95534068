"""The jobs of an evaluation: calibrate sensors, press objects, time profiles."""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import chain

import numpy as np

from tacshade_edge.core.calibration.calibrate import CalibrationResult
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.studies.evaluate.scenes import DEPTHS_MM, NULL_FRAMES, null_cases, press_cases, scenes
from tacshade_edge.studies.evaluate.score import Row, score
from tacshade_edge.studies.evaluate.sensors import PRESSES, REFERENCES, SensorName, calibrate_sensors, reconstructor
from tacshade_edge.studies.parallel import Report, Workers, reported_map
from tacshade_edge.studies.stage_times import one_thread
from tacshade_edge.types import Calibration, Frame

TIMED_OBJECTS, TIMED_ROUNDS = 5, 3
"""Number of timed frames, and of rounds over them."""


@dataclass(frozen=True, slots=True)
class Plan:
    """The plan of an evaluation, with numbers of images for each sensor; equal plans give equal rows."""

    sensors: tuple[SensorName, ...]
    profiles: tuple[str, ...]
    objects: tuple[str, ...] = tuple(OBJECTS)
    references: int = REFERENCES
    presses: int = PRESSES
    depths_mm: tuple[float, ...] = DEPTHS_MM
    null_frames: int = NULL_FRAMES


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """The result of a plan: a row for each frame and profile, and each sensor's calibration."""

    rows: tuple[Row, ...]
    calibrations: tuple[CalibrationResult, ...]


@dataclass(frozen=True, slots=True)
class Timing:
    """The time in ms of a frame in contact, on one thread of an otherwise idle machine."""

    p50_ms: float
    steps: int


def evaluate(plan: Plan, workers: Workers, report: Report) -> Evaluation:
    """Run a plan. Raises ConfigError (a sensor cannot be calibrated) and DeviceError (a worker was killed)."""
    found = tuple(calibrate_sensors(plan.sensors, plan.references, plan.presses, workers, report))
    known = [(plan, name, made.calibration) for name, made in zip(plan.sensors, found, strict=True)]
    tasks = [(*each, what) for each in known for what in (*plan.objects, None)]
    rows = chain.from_iterable(reported_map(_rows, tasks, workers, report, "objects pressed"))
    return Evaluation(tuple(rows), found)


def _rows(task: tuple[Plan, SensorName, Calibration, str | None]) -> list[Row]:
    """Score every profile on every press of one object on one sensor, or on frames without contact."""
    plan, name, calibration, object_name = task
    sensor = name.make()
    made = [reconstructor(calibration, profile) for profile in plan.profiles]
    cases = (
        null_cases(name, sensor, plan.null_frames)
        if object_name is None
        else press_cases(name, sensor, scenes(sensor.model, name.seed, object_name, plan.depths_mm))
    )
    return [score(case.label, case.truth, each.step(Frame(0, 0, 0, case.image))) for case in cases for each in made]


def time_profiles(plan: Plan, calibration: Calibration, report: Report) -> dict[str, Timing]:
    """Time every profile on the first sensor and the first objects, each pressed in the middle at the middle depth.

    Profiles run one after another in this process, with one OpenCV thread.
    """
    name = plan.sensors[0]
    sensor = name.make()
    depth_mm = plan.depths_mm[len(plan.depths_mm) // 2]
    frames = []
    for object_name in plan.objects[:TIMED_OBJECTS]:
        scene = scenes(sensor.model, name.seed, object_name, (depth_mm,))[0]
        frames.append(Frame(0, 0, 0, sensor.frame((scene.press,), scene.noise_seed).image))
    timings = {}
    with one_thread():
        for k, profile in enumerate(plan.profiles):
            report("profiles timed", k, len(plan.profiles))
            made = reconstructor(calibration, profile)
            made.step(frames[0])  # the first step imports and allocates
            taken = []
            for frame in frames * TIMED_ROUNDS:
                start = time.perf_counter_ns()
                made.step(frame)
                taken.append((time.perf_counter_ns() - start) / 1e6)
            timings[profile] = Timing(float(np.median(taken)), len(taken))
        report("profiles timed", len(plan.profiles), len(plan.profiles))
    return timings
