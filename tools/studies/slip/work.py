"""The jobs of the study: objects slide over calibrated sensors, are held, or are lifted off."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from tacshade_edge.core.contact.tracking import ContactTracker, follow
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.studies.evaluate.sensors import PRESSES, REFERENCES, SensorName, calibrate_sensors, reconstructor
from tacshade_edge.studies.parallel import Report, Workers, reported_map
from tacshade_edge.types import Calibration, Frame, Need, Slip
from tools.testbed.simulator.motion import Motion, pressed
from tools.testbed.simulator.moving_scene import MovingScene

FPS = 60
OBJECT_NAMES = ("ball", "cube")
"""A round object and one with edges, both narrower than `WAY_MM`."""
SPEEDS_MM_S = (5.0, 10.0, 20.0)
DIRECTIONS_DEG = (20.0, 200.0)
DEPTH_MM, WAY_MM, HELD_DRAG_MM = 2.5, 8.0, 1.0
"""Depth, path and drag, on a skin of 20 mm."""
HELD_S = 600.0
"""Time that is shared by all held objects."""
SETTLED_S = 1.0
"""How long an object rests after its drag before frames count, because the skin creeps."""
RELEASED_S, AFTER_S = 600.0, 3.0
"""Total time that the study sees after releases, and time after each release, in which its dent recovers."""
SOON_S, LATER_FPS = 0.2, 10
"""Time after a release in which the study sees every frame, and frames per second after that."""
LIFT_MM_S = 20.0


@dataclass(frozen=True, slots=True)
class Plan:
    """The parameters of a study; equal plans give equal rows."""

    sensors: tuple[SensorName, ...]
    profiles: tuple[str, ...]
    objects: tuple[str, ...] = OBJECT_NAMES
    speeds_mm_s: tuple[float, ...] = SPEEDS_MM_S
    held_s: float = HELD_S
    released_s: float = RELEASED_S


@dataclass(frozen=True, slots=True)
class SlideRow:
    """An object that is dragged until it slides, seen by one profile; each attribute is a column of slip_slides.csv.

    Attributes
    ----------
    profile, sensor, object : str
    speed_mm_s, direction_deg : float
    onset_s : float
        When the whole contact truly slides; NaN: never.
    told_s : float
        When a slip was first reported; NaN: never.
    found_mm_s, true_mm_s : float
        Speed over the skin 0.15 s after the onset; NaN if none is reported.
    """

    profile: str
    sensor: str
    object: str
    speed_mm_s: float
    direction_deg: float
    onset_s: float
    told_s: float
    found_mm_s: float
    true_mm_s: float


@dataclass(frozen=True, slots=True)
class HeldRow:
    """An object that was dragged too little to slide and is held; each attribute is a column of slip_held.csv."""

    profile: str
    sensor: str
    object: str
    held_s: float
    slips: int


@dataclass(frozen=True, slots=True)
class ReleaseRow:
    """An object that is lifted off, seen by one profile; each attribute is a column of slip_releases.csv.

    Attributes
    ----------
    profile, sensor, object : str
    depth_mm : float
        Depth at which it was held for half a second.
    dent_mm : float
        Greatest h that remains when nothing touches.
    told_s : float
        Time from the first frame without contact to the first frame reported as such; NaN: not within `AFTER_S`.
    frames, phantoms : int
        Number of frames after that report, and of those in which a contact is reported.
    """

    profile: str
    sensor: str
    object: str
    depth_mm: float
    dent_mm: float
    told_s: float
    frames: int
    phantoms: int


Row = SlideRow | HeldRow | ReleaseRow


def study(plan: Plan, workers: Workers, report: Report) -> tuple[Row, ...]:
    """Run a plan. Raises ConfigError (a sensor cannot be calibrated) and DeviceError (a worker was killed)."""
    found = calibrate_sensors(plan.sensors, REFERENCES, PRESSES, workers, report)
    known = [(plan, name, made.calibration) for name, made in zip(plan.sensors, found, strict=True)]
    tasks = [(*each, what, speed) for each in known for what in plan.objects for speed in (*plan.speeds_mm_s, 0.0)]
    tasks.sort(key=lambda task: task[-1])  # held objects take longest, so they come first
    return tuple(chain.from_iterable(reported_map(_rows, tasks, workers, report, "objects that slide or are held")))


def _rows(task: tuple[Plan, SensorName, Calibration, str, float]) -> list[Row]:
    plan, name, calibration, object_name, speed_mm_s = task
    made = [reconstructor(calibration, profile) for profile in plan.profiles]
    if not speed_mm_s:
        parts = len(plan.sensors) * len(plan.objects)
        releases = round(plan.released_s / AFTER_S / parts)
        held = _held(name, made, object_name, plan.held_s / parts)
        return [*held, *(row for k in range(releases) for row in _released(name, made, object_name, k))]
    return [row for way in DIRECTIONS_DEG for row in _slides(name, made, object_name, speed_mm_s, way)]


def way_of(name: SensorName, object_name: str, direction_deg: float) -> Motion:
    """Press an object on one side of the tip, ready for a path across the tip."""
    scale = name.make().model.skin_radius_mm / 20
    x, y = (-0.4 * WAY_MM * scale * f(math.radians(direction_deg)) for f in (math.cos, math.sin))
    return pressed(Press(OBJECTS[object_name](), x, y, DEPTH_MM * scale, 30.0, scale), 0.0, LIFT_MM_S).held(0.3)


def _slides(
    name: SensorName, made: Sequence[Reconstructor], object_name: str, speed_mm_s: float, direction_deg: float
) -> list[SlideRow]:
    model = name.make().model
    scale, begun = model.skin_radius_mm / 20, way_of(name, object_name, direction_deg)
    x, y = (WAY_MM * scale * f(math.radians(direction_deg)) for f in (math.cos, math.sin))
    motion = begun.dragged(x, y, speed_mm_s)
    scene = MovingScene([motion], model)
    first, last = math.ceil(begun.times_s[-1] * FPS), math.floor(motion.times_s[-1] * FPS)
    onset = first + bisect_left(range(first, last + 1), True, key=lambda k: scene.objects(k / FPS)[0].slip is Slip.FULL)
    end = min(last, onset + FPS // 4)
    trackers = [ContactTracker() for _ in made]
    told = [math.nan] * len(made)
    speeds = [math.nan] * len(made)
    measured = onset + round(0.15 * FPS)
    for k in range(math.ceil(begun.times_s[1] * FPS), end + 1):
        image = scene.frame(k / FPS, k).image
        for j, each in enumerate(made):
            result = follow(trackers[j], each.step(Frame(k, round(1e9 * k / FPS), 0, image)))
            slipping = [o for o in result.objects if o.slip is Slip.FULL]
            if slipping and math.isnan(told[j]):
                told[j] = k / FPS
            if k == measured and result.objects and result.objects[0].slip_mm_s is not None:
                speeds[j] = result.objects[0].slip_mm_s
    true_mm_s = scene.objects(measured / FPS)[0].slip_mm_s if measured <= last else math.nan
    onset_s = onset / FPS if onset <= last else math.nan
    return [
        SlideRow(each.profile.name, str(name), object_name, speed_mm_s, direction_deg, onset_s, t, v, true_mm_s)
        for each, t, v in zip(made, told, speeds, strict=True)
    ]


def _held(name: SensorName, made: Sequence[Reconstructor], object_name: str, held_s: float) -> list[HeldRow]:
    model = name.make().model
    scale = model.skin_radius_mm / 20
    motion = way_of(name, object_name, 0.0).dragged(HELD_DRAG_MM * scale, 0.0, 10.0).held(held_s + SETTLED_S)
    scene = MovingScene([motion], model)
    first = math.ceil((motion.times_s[-2] + SETTLED_S) * FPS)
    trackers = [ContactTracker() for _ in made]
    slips, sliding = [0] * len(made), [False] * len(made)
    for k in range(first, first + round(held_s * FPS)):
        image = scene.frame(k / FPS, k).image
        for j, each in enumerate(made):
            result = follow(trackers[j], each.step(Frame(k, round(1e9 * k / FPS), 0, image)))
            now = any(o.slip is Slip.FULL for o in result.objects)
            slips[j] += now and not sliding[j]
            sliding[j] = now
    return [HeldRow(each.profile.name, str(name), object_name, held_s, n) for each, n in zip(made, slips, strict=True)]


def _released(name: SensorName, made: Sequence[Reconstructor], object_name: str, k: int) -> list[ReleaseRow]:
    model = name.make().model
    scale, rng = model.skin_radius_mm / 20, np.random.default_rng((0 if name.seed is None else name.seed + 1, 41, k))
    rho, angle, depth_mm = rng.uniform((0, 0, 1), (6, 2 * math.pi, 4.5)) * (scale, 1, scale)
    press = Press(
        OBJECTS[object_name](),
        rho * math.cos(angle),
        rho * math.sin(angle),
        depth_mm,
        float(rng.uniform(0, 360)),
        scale,
    )
    motion = pressed(press, 0.0, LIFT_MM_S).held(0.5).released(2 * LIFT_MM_S)
    scene = MovingScene([motion], model)
    lifted, gone = (math.floor(FPS * t) for t in motion.times_s[-3:-1])
    free = lifted + bisect_left(range(lifted, gone + 2), True, key=lambda f: not scene.objects(f / FPS)[0].touches)
    soon = range(free, free + round(SOON_S * FPS))
    later = range(soon.stop, free + round(AFTER_S * FPS), FPS // LATER_FPS)
    told, frames, phantoms = [math.nan] * len(made), [0] * len(made), [0] * len(made)
    for f in (*soon, *later):
        image = scene.frame(f / FPS, f).image
        for j, each in enumerate(made):
            contact = each.step(Frame(f, round(1e9 * f / FPS), 0, image), need=Need.DEPTH)
            if math.isnan(told[j]):
                told[j] = math.nan if contact is None or contact.contact else (f - free) / FPS
            else:
                frames[j] += 1
                phantoms[j] += contact is None or contact.contact
    dent_mm = float(scene.skin(free / FPS).height_mm.max())
    return [
        ReleaseRow(each.profile.name, str(name), object_name, depth_mm, dent_mm, told_s, after, wrong)
        for each, told_s, after, wrong in zip(made, told, frames, phantoms, strict=True)
    ]
