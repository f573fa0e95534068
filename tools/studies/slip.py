"""How soon slips and releases are reported, and how often falsely.

::

    .venv/bin/python -m tools.studies.slip [--profile NAME...] [--sensors SEED,... | --final]
        [--held SECONDS]
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.studies.evaluate.work import SensorName, reconstructor
from tacshade_edge.lab.studies.markdown import grouped, summary
from tacshade_edge.sensor.contact.tracking import ContactTracker, follow
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import Calibration, Frame, Need, Reconstruction, Slip
from tools.studies import command
from tools.testbed.simulator.families import FINAL_SENSORS
from tools.testbed.simulator.moving_scene import Motion, MovingScene, pressed

FPS = 60
OBJECT_NAMES = ("ball", "cube")
"""A round object and one with edges, both narrower than `WAY_MM`."""
SPEEDS_MM_S = (5.0, 10.0, 20.0)
DIRECTIONS_DEG = (20.0, 200.0)
DEPTH_MM, WAY_MM, HELD_DRAG_MM = 2.5, 8.0, 1.0
"""Depth, path and drag, on a skin of 20 mm."""
SETTLED_S = 1.0
"""How long an object rests after its drag before frames count, because the skin creeps."""
AFTER_S = 3.0
"""Time that the study sees after each release, in which its dent recovers."""
SOON_S, LATER_FPS = 0.2, 10
"""Time after a release in which the study sees every frame, and frames per second after that."""
LIFT_MM_S = 20.0
WITHIN_S, EARLY_S = 0.1, 0.05
"""Limits in s: a report is in time up to `WITHIN_S` after the onset,
and false more than `EARLY_S` before it.
"""


@dataclass(frozen=True, slots=True)
class Plan:
    """The parameters of a study; all held objects share `held_s`, and all releases `released_s`."""

    sensors: tuple[SensorName, ...]
    profiles: tuple[str, ...]
    objects: tuple[str, ...] = OBJECT_NAMES
    speeds_mm_s: tuple[float, ...] = SPEEDS_MM_S
    held_s: float = 600.0
    released_s: float = 600.0


@dataclass(frozen=True, slots=True)
class Seen:
    """What begins every row."""

    profile: str
    sensor: str
    object: str


@dataclass(frozen=True, slots=True)
class SlideRow(Seen):
    """An object that is dragged until it slides, seen by one profile; NaN means never.

    `onset_s` is when the whole contact truly slides, `reported_s` when a slip was first reported,
    and the last two are speeds over the skin 0.15 s after the onset.
    """

    speed_mm_s: float
    direction_deg: float
    onset_s: float
    reported_s: float
    found_mm_s: float
    true_mm_s: float

    @property
    def is_early(self) -> bool:
        """Whether a slip was reported before the whole contact slid."""
        return self.reported_s < self.onset_s - EARLY_S or (
            math.isnan(self.onset_s) and not math.isnan(self.reported_s)
        )

    @property
    def is_in_time(self) -> bool:
        """Whether a slip was reported within `WITHIN_S` of its onset, but not early."""
        return not self.is_early and self.reported_s <= self.onset_s + WITHIN_S


@dataclass(frozen=True, slots=True)
class HeldRow(Seen):
    """An object that was dragged too little to slide and is held."""

    held_s: float
    slips: int


@dataclass(frozen=True, slots=True)
class ReleaseRow(Seen):
    """An object that is lifted off after half a second.

    `dent_mm` is the greatest h that remains when nothing touches, `reported_s` the time from the
    first frame without contact to the first frame reported as such (NaN: not within `AFTER_S`);
    `frames` counts the frames after that, and `phantoms` those in which a contact is reported.
    """

    depth_mm: float
    dent_mm: float
    reported_s: float
    frames: int
    phantoms: int


def rows(plan: Plan, task: tuple[SensorName, Calibration, tuple[float, str]]) -> list[Seen]:
    """Slide an object over a sensor at a speed; at speed 0, hold it and lift it off."""
    name, calibration, (speed_mm_s, object_name) = task
    made = [reconstructor(calibration, profile) for profile in plan.profiles]
    seen = [(each.profile.name, str(name), object_name) for each in made]
    if speed_mm_s:
        return [
            r
            for way in DIRECTIONS_DEG
            for r in _slides(name, made, seen, object_name, speed_mm_s, way)
        ]
    parts = len(plan.sensors) * len(plan.objects)
    found: list[Seen] = [*_held(name, made, seen, object_name, plan.held_s / parts)]
    for k in range(round(plan.released_s / AFTER_S / parts)):
        found += _released(name, made, seen, object_name, k)
    return found


_Seen = Sequence[tuple[str, str, str]]


def way_of(name: SensorName, object_name: str, direction_deg: float) -> Motion:
    """Press an object on one side of the tip, ready for a path across the tip."""
    scale = name.make().model.skin_radius_mm / 20
    x, y = (-0.4 * WAY_MM * scale * f(math.radians(direction_deg)) for f in (math.cos, math.sin))
    return pressed(
        Press(OBJECTS[object_name](), x, y, DEPTH_MM * scale, 30.0, scale), 0.0, LIFT_MM_S
    ).held(0.3)


def _followed(
    scene: MovingScene, made: Sequence[Reconstructor], frames: range
) -> Iterator[tuple[int, list[Reconstruction]]]:
    """Each frame's number, and what every reconstructor finds in it."""
    trackers = [ContactTracker() for _ in made]
    for k in frames:
        frame = Frame(k, round(1e9 * k / FPS), 0, scene.frame(k / FPS, k).image)
        yield (
            k,
            [
                follow(tracker, each.step(frame))
                for tracker, each in zip(trackers, made, strict=True)
            ],
        )


def _slips(result: Reconstruction) -> bool:
    return any(one.slip is Slip.FULL for one in result.objects)


def _slides(
    name: SensorName,
    made: Sequence[Reconstructor],
    seen: _Seen,
    object_name: str,
    speed_mm_s: float,
    way_deg: float,
) -> list[SlideRow]:
    model = name.make().model
    scale, begun = model.skin_radius_mm / 20, way_of(name, object_name, way_deg)
    x, y = (WAY_MM * scale * f(math.radians(way_deg)) for f in (math.cos, math.sin))
    motion = begun.dragged(x, y, speed_mm_s)
    scene = MovingScene([motion], model)
    first, last = math.ceil(begun.times_s[-1] * FPS), math.floor(motion.times_s[-1] * FPS)
    onset = first + bisect_left(
        range(first, last + 1), True, key=lambda k: scene.objects(k / FPS)[0].slip is Slip.FULL
    )
    reported, speeds = [math.nan] * len(made), [math.nan] * len(made)
    measured = onset + round(0.15 * FPS)
    for k, results in _followed(
        scene, made, range(math.ceil(begun.times_s[1] * FPS), min(last, onset + FPS // 4) + 1)
    ):
        for j, result in enumerate(results):
            if math.isnan(reported[j]) and _slips(result):
                reported[j] = k / FPS
            if k == measured and result.objects and result.objects[0].slip_mm_s is not None:
                speeds[j] = result.objects[0].slip_mm_s
    true_mm_s = scene.objects(measured / FPS)[0].slip_mm_s if measured <= last else math.nan
    onset_s = onset / FPS if onset <= last else math.nan
    return [
        SlideRow(*who, speed_mm_s, way_deg, onset_s, reported_s, found_mm_s, true_mm_s)
        for who, reported_s, found_mm_s in zip(seen, reported, speeds, strict=True)
    ]


def _held(
    name: SensorName, made: Sequence[Reconstructor], seen: _Seen, object_name: str, held_s: float
) -> list[HeldRow]:
    model = name.make().model
    drag_mm = HELD_DRAG_MM * model.skin_radius_mm / 20
    motion = way_of(name, object_name, 0.0).dragged(drag_mm, 0.0, 10.0).held(held_s + SETTLED_S)
    first = math.ceil((motion.times_s[-2] + SETTLED_S) * FPS)
    slips, sliding = [0] * len(made), [False] * len(made)
    for _, results in _followed(
        MovingScene([motion], model), made, range(first, first + round(held_s * FPS))
    ):
        now = [_slips(result) for result in results]
        slips = [
            count + (is_now and not was)
            for count, is_now, was in zip(slips, now, sliding, strict=True)
        ]
        sliding = now
    return [HeldRow(*who, held_s, count) for who, count in zip(seen, slips, strict=True)]


def _released(
    name: SensorName, made: Sequence[Reconstructor], seen: _Seen, object_name: str, k: int
) -> list[ReleaseRow]:
    model = name.make().model
    scale, rng = (
        model.skin_radius_mm / 20,
        np.random.default_rng((0 if name.seed is None else name.seed + 1, 41, k)),
    )
    rho, angle, depth_mm = rng.uniform((0, 0, 1), (6, 2 * math.pi, 4.5)) * (scale, 1, scale)
    place = (rho * math.cos(angle), rho * math.sin(angle))
    press = Press(OBJECTS[object_name](), *place, depth_mm, float(rng.uniform(0, 360)), scale)
    motion = pressed(press, 0.0, LIFT_MM_S).held(0.5).released(2 * LIFT_MM_S)
    scene = MovingScene([motion], model)
    lifted, gone = (math.floor(FPS * t) for t in motion.times_s[-3:-1])
    free = lifted + bisect_left(
        range(lifted, gone + 2), True, key=lambda f: not scene.objects(f / FPS)[0].touches
    )
    soon = range(free, free + round(SOON_S * FPS))
    later = range(soon.stop, free + round(AFTER_S * FPS), FPS // LATER_FPS)
    reported, frames, phantoms = [math.nan] * len(made), [0] * len(made), [0] * len(made)
    for f in (*soon, *later):
        image = scene.frame(f / FPS, f).image
        for j, each in enumerate(made):
            contact = each.step(Frame(f, round(1e9 * f / FPS), 0, image), need=Need.DEPTH)
            touches = contact is None or contact.contact
            if math.isnan(reported[j]):
                reported[j] = math.nan if touches else (f - free) / FPS
            else:
                frames[j] += 1
                phantoms[j] += touches
    dent_mm = float(scene.skin(free / FPS).height_mm.max())
    return [
        ReleaseRow(*who, depth_mm, dent_mm, reported_s, after, wrong)
        for who, reported_s, after, wrong in zip(seen, reported, frames, phantoms, strict=True)
    ]


def _there(some: Sequence[SlideRow]) -> list[SlideRow]:
    return [row for row in some if not math.isnan(row.onset_s)]


def _median(values: Sequence[float], spec: str) -> str:
    known = [value for value in values if not math.isnan(value)]
    return format(np.median(known), spec) if known else ""


def _in_time(some: Sequence[SlideRow]) -> str:
    return f"{100 * np.mean([row.is_in_time for row in some]):.0f}" if some else ""


def _ratio(row: SlideRow) -> float:
    return row.found_mm_s / row.true_mm_s if row.true_mm_s > 0 else math.nan


SLIDES: dict[str, Callable[[Sequence[SlideRow]], str]] = {
    "slips": lambda some: str(len(_there(some))),
    "in time %": lambda some: _in_time(_there(some)),
    "median delay ms": lambda some: _median(
        [1000 * (row.reported_s - row.onset_s) for row in some], ".0f"
    ),
    "never": lambda some: str(sum(math.isnan(row.reported_s) for row in _there(some))),
    "early": lambda some: str(sum(row.is_early for row in some)),
    "speed found / true": lambda some: _median([_ratio(row) for row in _there(some)], ".2f"),
}


def _latest_s(some: Sequence[ReleaseRow]) -> float:
    reported_s = (row.reported_s for row in some if not math.isnan(row.reported_s))
    return max(reported_s, default=math.nan)


HELD: dict[str, Callable[[Sequence[HeldRow]], str]] = {
    "minutes": lambda some: f"{sum(row.held_s for row in some) / 60:.1f}",
    "slips reported": lambda some: str(sum(row.slips for row in some)),
}
RELEASES: dict[str, Callable[[Sequence[ReleaseRow]], str]] = {
    "releases": lambda some: str(len(some)),
    "deepest dent mm": lambda some: f"{max(row.dent_mm for row in some):.2f}",
    "in time %": lambda some: f"{100 * np.mean([row.reported_s <= WITHIN_S for row in some]):.0f}",
    "latest ms": lambda some: f"{1000 * _latest_s(some):.0f}",
    "never": lambda some: str(sum(math.isnan(row.reported_s) for row in some)),
    "frames after": lambda some: str(sum(row.frames for row in some)),
    "phantoms": lambda some: str(sum(row.phantoms for row in some)),
}


def text(found: Sequence[Seen]) -> str:
    """A table for each kind of rows."""
    slides = grouped((row for row in found if isinstance(row, SlideRow)), "profile")
    held = grouped((row for row in found if isinstance(row, HeldRow)), "profile")
    released = grouped((row for row in found if isinstance(row, ReleaseRow)), "profile")
    by_speed = [
        ((speed, profile), some)
        for profile, of in slides.items()
        for speed, some in (
            *grouped(of, lambda row: f"{row.speed_mm_s:g} mm/s").items(),
            ("all", of),
        )
    ]
    parts = (
        ("slide", summary(("speed", "method"), by_speed, SLIDES)),
        ("are held", summary(("method",), [((name,), of) for name, of in held.items()], HELD)),
        (
            "are lifted off",
            summary(("method",), [((name,), of) for name, of in released.items()], RELEASES),
        ),
    )
    return "\n\n".join(f"Objects that {what}\n\n{table}" for what, table in parts)


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = command.options("Slips and releases over time.", "default,5,11", FINAL_SENSORS[:3])
    parser.add_argument(
        "--held", type=float, default=600.0, metavar="SECONDS", help="over all held objects (600)"
    )
    args = parser.parse_args(words)
    if any(sensor.family != "tacshade" for sensor in args.sensors):
        parser.error("--sensors: only the family tacshade moves in time")
    plan = Plan(args.sensors, tuple(args.profile), held_s=args.held)
    parts = [(speed, what) for speed in (0.0, *plan.speeds_mm_s) for what in plan.objects]
    work = partial(
        command.over_sensors, partial(rows, plan), plan.sensors, parts, fitted=args.fitted
    )
    command.run(
        parser,
        args,
        "slip",
        work,
        text,
        {"_slides": SlideRow, "_held": HeldRow, "_releases": ReleaseRow},
    )


if __name__ == "__main__":
    main()
