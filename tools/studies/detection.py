#!/usr/bin/env python3
"""Are touches found, and no untouched frame taken for one, with limits of the sensor at rest?

::

    .venv/bin/python -m tools.studies.detection simulated --sensors default,other:5,tactip:7
    .venv/bin/python -m tools.studies.detection tilted out/real/tactile-manibot
    .venv/bin/python -m tools.studies.detection raw out/real/aerial_tactile_servoing
    .venv/bin/python -m tools.studies.detection flat out/real/TacTipFlexSim

Found is a contact, or `touched`. Of real sets, half of the free frames are the rest that `calibrate
--rest` learns from and the others are judged, then the halves change places. Of `tilted`, which
states forces, frames below `FREE_N` are free. Of `raw`, whose tips sway, every free frame is the
reference in turn, without a rest and with one.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.images import read_image
from tacshade_edge.lab.parallel import reported_map, workers
from tacshade_edge.lab.simulator.press import Press, ball
from tacshade_edge.lab.studies.evaluate.work import PressedSensor, SensorName, reconstructor
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.inference.rest_evidence import learn_rest
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Calibration, Frame
from tools.studies.disturbances import CHANGES, LEFT, RELEASED
from tools.studies.judges import calibrated, press_of
from tools.studies.limits import ball_press, places
from tools.studies.real_sets import SENSOR, SENSORS, SETS, TILTED, rows_of, thinned
from tools.testbed.simulator.families import FINAL_SENSORS, released, working_sensors

PROFILES = ("fast", "balanced", "accurate")
FREE_N = 0.13
"""Force along the axis below which a frame of `tilted` is free: the 34 least loaded ones."""
LEAST_N, SURE_N = 0.5, 2.0
PRESSES = 400
REST_FRAMES = 60  # of a simulated sensor: a minute, one a second
FAINT_MM = 0.3
RADII_MM = (3.0, 6.0, 9.0)
S = 10**9


@dataclass(frozen=True, slots=True)
class Answer:
    """What a profile says of a frame of some kind."""

    profile: str
    kind: str
    valid: bool
    contact: bool
    touched: bool
    degraded: str

    @property
    def found(self) -> bool:
        """Whether it says that something touches."""
        return self.valid and (self.contact or self.touched)


def answer(made: Reconstructor, kind: str, image: U8, t_ns: int = 0) -> Answer:
    """Ask a profile."""
    result = made.step(Frame(0, t_ns, 0, image))
    degraded = result.degraded.code.value if result.degraded else ""
    return Answer(result.profile, kind, result.valid, result.contact, result.touched, degraded)


def share(some: Sequence[Answer], said: Callable[[Answer], bool]) -> str:
    """How many of them, as text."""
    return f"{sum(map(said, some))} of {len(some)}"


@dataclass(frozen=True, slots=True)
class Known:
    """A picture of a real set and the force that pressed it, N (0: free;
    of a set without forces, above `SURE_N`).
    """

    path: Path
    force_n: float


def known_frames(name: str, clone: Path) -> list[Known]:
    """A set's frames, free ones first."""
    frames = SETS[name](clone)
    if name != "tilted":
        return sorted(
            (Known(each.path, 0.0 if each.free else math.inf) for each in frames),
            key=lambda one: one.force_n,
        )
    forces = {
        row["sensor_image"]: float(row["Fz"]) for row in rows_of(clone / TILTED / "targets.csv")
    }
    free = [each for each in frames if forces[each.path.name] < FREE_N]
    pressed = [each for each in frames if forces[each.path.name] >= FREE_N]
    return [
        *(Known(each.path, 0.0) for each in free),
        *(Known(each.path, forces[each.path.name]) for each in thinned(pressed, PRESSES)),
    ]


@cache
def picture(path: Path) -> U8:
    """A picture in grey."""
    return to_grey(read_image(path))


def referred(name: str, path: Path) -> Calibration:
    """Calibrated from one picture, also one that seems loaded."""
    sensor = SENSORS.get(name, SENSOR)
    return calibrate(sensor, [picture(path)], allow_loaded_reference=True).calibration


def with_rest(calibration: Calibration, rest: Sequence[Known]) -> Calibration:
    """With the limits that these frames set."""
    learnt = learn_rest(calibration, ((one.path.name, picture(one.path)) for one in rest))
    return replace(calibration, rest=learnt.limits)


def answers(calibration: Calibration, frames: Sequence[Known]) -> list[Answer]:
    """Those of all profiles; the kind of a frame is the force."""
    made = [reconstructor(calibration, profile) for profile in PROFILES]
    images = ((one, picture(one.path)) for one in frames)
    return [answer(each, str(one.force_n), image) for one, image in images for each in made]


def counts(some: Sequence[Answer], profile: str) -> tuple[str, ...]:
    """False on free frames, of those as contacts; missed,
    and of those with a force above the least; silent.
    """
    own = [one for one in some if one.profile == profile]
    free = [one for one in own if float(one.kind) == 0]
    columns = [
        share(free, lambda one: one.found),
        share(free, lambda one: one.valid and one.contact),
    ]
    for least_n in (SURE_N, LEAST_N):
        pressed = [one for one in own if float(one.kind) > least_n]
        columns.append(share(pressed, lambda one: not one.found))
        columns.append(share(pressed, lambda one: one.valid and not one.found and not one.degraded))
    return tuple(columns)


COUNTS = (
    "false",
    "of those contacts",
    f"missed over {SURE_N:g} N",
    "silently",
    f"missed over {LEAST_N:g} N",
    "silently",
)


def halves(name: str, clone: Path) -> None:
    """Judge a set by halves of its free frames, and without a rest."""
    frames = known_frames(name, clone)
    free = [one for one in frames if one.force_n == 0]
    pressed = [one for one in frames if one.force_n > 0]
    rows = []
    for what, rest, others in (
        ("none", [], free[1:]),
        ("first half", free[::2], free[1::2]),
        ("second half", free[1::2], free[::2]),
    ):
        calibration = referred(name, (rest or free)[0].path)
        if rest:
            calibration = with_rest(calibration, rest)
        some = answers(calibration, [*others, *pressed])
        rows += [(what, profile, *counts(some, profile)) for profile in PROFILES]
    print(markdown(("rest", "profile", *COUNTS), rows))


def turns(name: str, clone: Path, step: int) -> None:
    """Judge a set with its free frames as the reference in turn;
    the rest is every second one of the others.
    """
    frames = known_frames(name, clone)
    free = [one for one in frames if one.force_n == 0]
    pressed = [one for one in frames if one.force_n > 0]
    totals: dict[tuple[str, str], list[tuple[int, int, int]]] = {}
    for at in range(0, len(free), step):
        others = [one for one in free if one is not free[at]]
        calibration = referred(name, free[at].path)
        for rest, judged in (([], free), (others[::2], others[1::2]), (others[1::2], others[::2])):
            made = with_rest(calibration, rest) if rest else calibration
            some = answers(made, [*judged, *pressed])
            for profile in PROFILES:
                own = [one for one in some if one.profile == profile]
                false = sum(one.found for one in own if float(one.kind) == 0)
                contacts = sum(one.valid and one.contact for one in own if float(one.kind) == 0)
                lost = sum(not one.found for one in own if float(one.kind) > 0)
                key = ("half" if rest else "none", profile)
                totals.setdefault(key, []).append((false, contacts, lost))
    rows = []
    for (rest_name, profile), some_totals in totals.items():
        each = np.array(some_totals)
        spread = [f"{column.mean():.2f}, at most {column.max()}" for column in each.T]
        rows.append((rest_name, profile, str(len(each)), *spread))
    print(f"{len(free)} free frames, {len(pressed)} presses\n")
    print(markdown(("rest", "profile", "runs", "false", "of those contacts", "lost"), rows))


def simulated_frames(
    sensor: PressedSensor, seed: int, count: int, untouched: int
) -> Iterator[tuple[str, Sequence[U8]]]:
    """Sequences of pictures, of which the last is judged:
    untouched ones, faint presses, presses of any kind.
    """
    for k in range(untouched):
        yield "at rest", [sensor.frame((), 30_000 + k).image]
    changes = list(CHANGES)[1:]
    for k in range(count):
        what = changes[k % len(changes)]
        rng = np.random.default_rng((seed, 61, k))
        yield what, [CHANGES[what](sensor.frame((), 40_000 + k).image, sensor.model, rng)]
    for k in range(max(count // 5, 1)):
        rng = np.random.default_rng((seed, 62, k))
        reach, angle = (
            sensor.model.skin_radius_mm * rng.uniform(0, 0.4),
            rng.uniform(0, 2 * math.pi),
        )
        x_mm, y_mm = reach * math.cos(angle), reach * math.sin(angle)
        press = Press(ball(rng.uniform(3, 9)), x_mm, y_mm, rng.uniform(2, 4))
        left = released(sensor, (press,), rng.uniform(*LEFT), 50_000 + k).image
        yield RELEASED, [sensor.frame((press,), 60_000 + k).image, left]
    for radius_mm in RADII_MM:
        for k, (x_mm, y_mm) in enumerate(places(sensor.model, 12, 0.4, seed)):
            press = ball_press(sensor.model.skin_radius_mm, radius_mm, x_mm, y_mm, FAINT_MM)
            yield f"ball of {FAINT_MM:g} mm", [sensor.frame((press,), 70_000 + k).image]
    for k in range(count):
        press = press_of(sensor, np.random.default_rng((seed, 63, k)))
        yield "press", [sensor.frame((press,), 80_000 + k).image]


def judged(task: tuple[SensorName, int, int]) -> list[tuple[str, Answer, Answer]]:
    """A sensor's frames as they are answered without and with a rest."""
    name, count, untouched = task
    sensor = name.make()
    bare = calibrated(sensor)
    rest = ((str(k), sensor.frame((), 20_000 + k).image) for k in range(REST_FRAMES))
    limited = replace(bare, rest=learn_rest(bare, rest).limits)
    made = [(reconstructor(bare, each), reconstructor(limited, each)) for each in PROFILES]
    rows = []
    for at, (kind, images) in enumerate(simulated_frames(sensor, name.seed or 0, count, untouched)):
        for pair in made:
            two: list[Any] = [None, None]
            for second, image in enumerate(images):
                t_ns = (100 * at + second) * S
                two = [answer(each, kind, image, t_ns) for each in pair]
            rows.append((str(name), two[0], two[1]))
    return rows


def simulated(sensors: Sequence[SensorName], count: int, untouched: int) -> None:
    """Judge simulated sensors and print."""
    rows: list[tuple[str, Answer, Answer]] = []
    with workers() as pool:
        tasks = [(name, count, untouched) for name in sensors]
        for some in reported_map(judged, tasks, pool, Progress(), "sensors"):
            rows += some
    kinds = dict.fromkeys(before.kind for _, before, _ in rows)
    table, hidden = [], []
    for kind in kinds:
        for profile in PROFILES:
            own = [row for row in rows if row[1].kind == kind and row[1].profile == profile]
            before, after = [row[1] for row in own], [row[2] for row in own]
            table.append(
                (
                    kind,
                    profile,
                    share(before, lambda one: one.valid and one.contact),
                    share(after, lambda one: one.valid and one.contact),
                    share(after, lambda one: one.touched),
                    share(after, lambda one: one.found),
                )
            )
            hidden += [b.contact and not a.contact for _, b, a in own]
    columns = ("frames", "profile", "contact before", "contact", "touched", "found")
    print(markdown(columns, table))
    print(f"\nContacts that a rest hides: {sum(hidden)} of {len(hidden)} frames.")
    moving = sum(one.degraded == ReasonCode.TIP_MOVING for _, *two in rows for one in two)
    print(f"Frames called a motion of the tip: {moving} of {2 * len(rows)}.")


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    what = parser.add_subparsers(dest="what", required=True)
    own = what.add_parser("simulated")
    which = own.add_mutually_exclusive_group()
    which.add_argument("--sensors", type=working_sensors, metavar="SEED,...")
    which.add_argument("--final", action="store_true", help="those that are kept for final figures")
    own.add_argument("--untouched", type=int, default=200, metavar="N", help="at rest (200)")
    own.add_argument("--frames", type=int, default=200, metavar="N", help="of most kinds (200)")
    for name in ("tilted", "raw", "flat"):
        real = what.add_parser(name)
        real.add_argument("clone", type=Path)
        real.add_argument(
            "--step", type=int, default=1, metavar="N", help="every Nth reference (1)"
        )
    args = parser.parse_args()
    cv2.setNumThreads(1)
    try:
        if args.what == "simulated":
            working = args.sensors or working_sensors("default,other:5,tactip:7")
            sensors = FINAL_SENSORS if args.final else working
            simulated(sensors, args.frames, args.untouched)
        else:
            run = partial(turns, step=args.step) if args.what == "raw" else halves
            run(args.what, args.clone)
    except (ConfigError, DecodeError) as error:
        print(f"detection.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
