"""How well a hand knows the motion of the object that it holds.

::

    .venv/bin/python -m tools.studies.object_motion [--trials 3] [--final] [--csv FILE]

A simulated hand holds an object, and the study draws and reconstructs the pictures of all five fingers, which takes a
minute of one core per trial.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, cast

import numpy as np

from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.core.contact.tracking import ContactTracker
from tacshade_edge.core.hand import ObjectMotion, ObjectTracker, Patch
from tacshade_edge.core.reconstruct import step_and_track
from tacshade_edge.hand import patches_of
from tacshade_edge.protocol.hand import finger_of
from tacshade_edge.rigid import Rigid, turned_rad
from tacshade_edge.simulator.hand import HandScript, Placement, box, cylinder, sphere
from tacshade_edge.simulator.press import Shape
from tacshade_edge.studies.evaluate.work import calibrated, reconstructor
from tacshade_edge.studies.parallel import Report, Workers, reported_map, workers
from tacshade_edge.studies.tables import csv_text, summary
from tacshade_edge.types import F64, Frame
from tools.studies import command
from tools.testbed.simulator.families import sensor_name
from tools.testbed.simulator.held_hand import DrawnSensor, about, hand_frames, looking_at

FARTHEST_MM: Final = 2.5
"""Greatest motion of the patch that moves furthest."""
_HOME: Final = Rigid(np.eye(3), np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """The patches of a hand by a key that stays the same, and the object's true motion since the first moment."""

    t_ns: int
    patches: Mapping[str, Patch]
    moved: Rigid


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A grasp over time.

    Errors and jumps are measured at `points_mm` (n, 3) of the object in the hand's frame, its middle first.
    """

    object: str
    skin: str
    points_mm: F64
    moments: Iterable[Moment]


DRAWN_FPS: Final = 20
PROFILE: Final = "balanced"
RESTS_S, DRAWN_MOVES_S, DRAWN_HELD_S = 0.2, 1.0, 0.4
HALF_MM: Final = 30.0
BODIES: Final[dict[str, Shape]] = {
    "box": box(100.0, 70.0, 2 * HALF_MM),
    "cylinder": cylinder(HALF_MM, 120.0),
    "ball": sphere(HALF_MM + 10.0),
}
ALONG_MM: Final = {"box": 40.0, "cylinder": 40.0, "ball": 16.0}
FAMILIES: Final = ("5", "other:31", "two-scales:3")
FINAL_FAMILIES: Final = ("9021", "other:9021", "two-scales:9021")


@dataclass(frozen=True, slots=True)
class Drawing:
    """The parameters of one trial; equal ones give the same pictures."""

    body: str
    family: str
    seed: int


def drawings(trials: int, families: Sequence[str] = FAMILIES) -> list[Drawing]:
    """List the drawings: so many trials of each object and family."""
    return [Drawing(body, family, k) for k in range(trials) for body in BODIES for family in families]


def drawn_trial(drawing: Drawing) -> Trial:
    """Draw five fingers that hold a moving object, and reconstruct their pictures."""
    families = FAMILIES + FINAL_FAMILIES
    rng = np.random.default_rng((list(BODIES).index(drawing.body), families.index(drawing.family), drawing.seed))
    name = sensor_name(drawing.family)
    calibration = calibrated(name, 8, 20).calibration
    sensors = [cast(DrawnSensor, name.make()) for _ in range(5)]
    places = [
        looking_at(point_mm, along, rng.uniform(1.2, 2.0), sensors[0].model.skin_radius_mm)
        for point_mm, along in _held_at(drawing.body, rng)
    ]
    points_mm = np.array([place.apply(np.array((0.0, 0.0, sensors[0].model.skin_radius_mm))) for place in places])
    middle_mm = points_mm.mean(axis=0)
    target = _target(points_mm, rng)
    script = HandScript((0.0,), (Placement(_HOME),)).held(RESTS_S).moved(target, DRAWN_MOVES_S).held(DRAWN_HELD_S)
    frames = hand_frames(sensors, places, BODIES[drawing.body], script, DRAWN_FPS, seed=drawing.seed)
    made = [reconstructor(calibration, PROFILE) for _ in sensors]
    trackers = [ContactTracker() for _ in sensors]

    def moments() -> Iterator[Moment]:
        for k, frame in enumerate(frames):
            t_ns = round(1e9 * k / DRAWN_FPS)
            fingers = {}
            for finger, image, own, tracker, place in zip(
                frame.truth.fingers, frame.images, made, trackers, places, strict=True
            ):
                result = step_and_track(own, tracker, Frame(k, t_ns, t_ns, image))
                assert result is not None
                fingers[finger.name] = finger_of(result, place)
            patches = patches_of(fingers)
            if patches:
                yield Moment(t_ns, patches, frame.truth.motion)

    return Trial(drawing.body, drawing.family, np.vstack((middle_mm, points_mm)), moments())


def drawn_rows(drawings: Sequence[Drawing], workers: Workers, report: Report) -> list[MotionRow]:
    """Draw and score trials."""
    return list(reported_map(_drawn_row, drawings, workers, report, "hands"))


def _drawn_row(drawing: Drawing) -> MotionRow:
    return score(drawn_trial(drawing))


def _held_at(body: str, rng: np.random.Generator) -> list[tuple[F64, F64]]:
    """Draw where each fingertip touches the object, and the direction it faces: a thumb below, four fingers above."""
    spread_mm = ALONG_MM[body]
    held = []
    for k, along_mm in enumerate([0.0, *np.linspace(-spread_mm, spread_mm, 4)]):
        side = -1.0 if k == 0 else 1.0
        x_mm = along_mm + rng.uniform(-2.0, 2.0)
        around = math.radians(rng.uniform(-20, 20))
        if body == "box":
            point_mm, inwards = np.array((x_mm, rng.uniform(-8.0, 8.0), side * HALF_MM)), np.array((0.0, 0.0, -side))
        elif body == "cylinder":
            out = np.array((0.0, math.sin(around), side * math.cos(around)))
            point_mm, inwards = HALF_MM * out + np.array((x_mm, 0.0, 0.0)), -out
        else:
            out = np.array((x_mm, (HALF_MM + 10.0) * math.sin(around), 0.0)) / (HALF_MM + 10.0)
            out[2] = side * math.sqrt(1 - out @ out)
            point_mm, inwards = (HALF_MM + 10.0) * out, -out
        held.append((point_mm, inwards))
    return held


def _target(points_mm: F64, rng: np.random.Generator) -> Rigid:
    """Draw an object pose that moves the furthest touched point by 1 mm to `FARTHEST_MM`."""
    translation_mm, rotation_rad = rng.normal(size=3), rng.normal(size=3) / 20.0
    pose = about(_HOME, translation_mm, rotation_rad)
    way_mm = float(np.linalg.norm(pose.apply(points_mm) - points_mm, axis=1).max())
    part = rng.uniform(1.0, FARTHEST_MM) / way_mm
    return about(_HOME, part * translation_mm, part * rotation_rad)


CHI2_90: Final = (0.0, 2.706, 4.605, 6.251, 7.779, 9.236, 10.645)
"""90 % quantiles of the chi-squared distribution, by degrees of freedom."""


@dataclass(frozen=True, slots=True)
class MotionRow:
    """The result of a trial; lengths, angles and errors are those at the end."""

    object: str
    skin: str
    patch_mm: float  # true motion of the point that moved furthest
    turned_deg: float
    translation_off_mm: float  # of the object's middle
    rotation_off_deg: float
    ellipsoid: float  # squared error, weighted by the inverse covariance, over the bound of the 90 % ellipsoid
    jump_mm: float  # greatest change of a point's error from one moment to the next
    step_ms: float  # on one core


def score(trial: Trial) -> MotionRow:
    """Run the tracker on a trial and score it."""
    tracker = ObjectTracker()
    jump_mm, spent_s, count = 0.0, 0.0, 0
    before: F64 | None = None
    for moment in trial.moments:
        began_s = time.perf_counter()
        found = tracker.step(moment.t_ns, moment.patches)
        spent_s += time.perf_counter() - began_s
        count += 1
        assert found is not None
        error_mm = found.rigid().apply(trial.points_mm) - moment.moved.apply(trial.points_mm)
        if before is not None:
            jump_mm = max(jump_mm, float(np.linalg.norm(error_mm - before, axis=1).max()))
        before = error_mm
    assert before is not None
    assert found is not None
    left = found.rigid().rotation @ moment.moved.rotation.T
    way_mm = moment.moved.apply(trial.points_mm) - trial.points_mm
    return MotionRow(
        *(trial.object, trial.skin),
        *(float(np.linalg.norm(way_mm, axis=1).max()), _degrees(moment.moved.rotation)),
        *(float(np.linalg.norm(before[0])), _degrees(left), _ellipsoid(found, moment.moved), jump_mm),
        1000 * spent_s / count,
    )


def _degrees(rotation: F64) -> float:
    return float(np.degrees(np.linalg.norm(turned_rad(rotation))))


def _ellipsoid(found: ObjectMotion, truth: Rigid) -> float:
    """Compute the squared error, weighted by the inverse covariance, over its 90 % bound in the observed directions."""
    off_mm = found.about_mm + found.translation_mm - truth.apply(found.about_mm)
    error = np.append(off_mm, turned_rad(found.rigid().rotation @ truth.rotation.T))
    return float(error @ np.linalg.solve(found.covariance, error)) / CHI2_90[max(1, 6 - len(found.unobserved))]


def within(row: MotionRow) -> bool:
    """Whether the object's motion is known."""
    return row.translation_off_mm <= WITHIN_MM and row.rotation_off_deg <= WITHIN_DEG


WITHIN_MM, WITHIN_DEG = 0.4, 3.0


FIGURES: dict[str, Callable[[Sequence[MotionRow]], str]] = {
    "trials": lambda some: str(len(some)),
    "within 0.4 mm and 3° %": lambda some: f"{100 * np.mean([within(row) for row in some]):.0f}",
    "off mm: median": lambda some: f"{np.median([row.translation_off_mm for row in some]):.2f}",
    "95 %": lambda some: f"{np.quantile([row.translation_off_mm for row in some], 0.95):.2f}",
    "off °: median": lambda some: f"{np.median([row.rotation_off_deg for row in some]):.1f}",
    "off °: 95 %": lambda some: f"{np.quantile([row.rotation_off_deg for row in some], 0.95):.1f}",
    "in the 90 % ellipsoid %": lambda some: f"{100 * np.mean([row.ellipsoid <= 1 for row in some]):.0f}",
    "jump mm: greatest": lambda some: f"{max(row.jump_mm for row in some):.2f}",
    "ms a step": lambda some: f"{np.mean([row.step_ms for row in some]):.2f}",
}


def text(rows: Sequence[MotionRow]) -> str:
    """A table with rows for all trials, then for each object and family."""
    names = dict.fromkeys(name for row in rows for name in (row.object, row.skin))
    groups = [(("all",), rows), *(((name,), [r for r in rows if name in (r.object, r.skin)]) for name in names)]
    return summary(("what",), groups, FIGURES)


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description="Motion of a held object.")
    parser.add_argument("--trials", type=int, default=3, metavar="N", help="of each object and family")
    parser.add_argument("--final", action="store_true", help="the sensors kept for final figures")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write a row for each trial")
    args = parser.parse_args(words)
    with command.folder_for(parser, None), workers() as pool:
        rows = drawn_rows(drawings(args.trials, FINAL_FAMILIES if args.final else FAMILIES), pool, Progress())
    print(text(rows))
    if args.csv:
        args.csv.write_text(csv_text(MotionRow, rows), encoding="utf-8")


if __name__ == "__main__":
    main()
