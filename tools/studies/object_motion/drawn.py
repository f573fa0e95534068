"""A source of trials with pictures: a simulated hand holds an object, and each finger's picture is reconstructed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, cast

import numpy as np

from tacshade_edge.core.contact.tracking import ContactTracker
from tacshade_edge.core.reconstruct import step_and_track
from tacshade_edge.hand import patches_of
from tacshade_edge.protocol.hand import finger_of
from tacshade_edge.rigid import Rigid
from tacshade_edge.simulator.hand.bodies import box, cylinder, sphere
from tacshade_edge.simulator.hand.held import Placement
from tacshade_edge.simulator.hand.script import HandScript
from tacshade_edge.simulator.objects import Shape
from tacshade_edge.studies.evaluate.sensors import calibrated, reconstructor
from tacshade_edge.studies.parallel import Report, Workers, reported_map
from tacshade_edge.types import F64, Frame
from tools.studies.object_motion.score import MotionRow, score
from tools.studies.object_motion.trial import Moment, Trial
from tools.testbed.simulator.families import sensor_name
from tools.testbed.simulator.held_hand import DrawnSensor, about, hand_frames, looking_at

FPS: Final = 20
PROFILE: Final = "balanced"
RESTS_S, MOVES_S, HELD_S = 0.2, 1.0, 0.4
FARTHEST_MM: Final = 2.5
"""Greatest motion of the patch that moves furthest."""
HALF_MM: Final = 30.0
BODIES: Final[dict[str, Shape]] = {
    "box": box(100.0, 70.0, 2 * HALF_MM),
    "cylinder": cylinder(HALF_MM, 120.0),
    "ball": sphere(HALF_MM + 10.0),
}
ALONG_MM: Final = {"box": 40.0, "cylinder": 40.0, "ball": 16.0}
FAMILIES: Final = ("5", "other:31", "two-scales:3")
FINAL_FAMILIES: Final = ("9021", "other:9021", "two-scales:9021")
_HOME: Final = Rigid(np.eye(3), np.zeros(3))


@dataclass(frozen=True, slots=True)
class Drawing:
    """The parameters of one trial; equal ones give the same pictures."""

    body: str
    family: str
    seed: int


def drawings(trials: int, families: Sequence[str] = FAMILIES) -> list[Drawing]:
    """List the drawings: so many trials of each object and family."""
    return [Drawing(body, family, k) for k in range(trials) for body in BODIES for family in families]


def trial(drawing: Drawing) -> Trial:
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
    script = HandScript((0.0,), (Placement(_HOME),)).held(RESTS_S).moved(target, MOVES_S).held(HELD_S)
    frames = hand_frames(sensors, places, BODIES[drawing.body], script, FPS, seed=drawing.seed)
    made = [reconstructor(calibration, PROFILE) for _ in sensors]
    trackers = [ContactTracker() for _ in sensors]

    def moments() -> Iterator[Moment]:
        for k, frame in enumerate(frames):
            t_ns = round(1e9 * k / FPS)
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

    return Trial(drawing.body, drawing.family, "drawn", 5, np.vstack((middle_mm, points_mm)), moments())


def rows(trials: int, workers: Workers, report: Report, families: Sequence[str] = FAMILIES) -> list[MotionRow]:
    """Draw and score so many trials of each object and family."""
    return list(reported_map(_row, drawings(trials, families), workers, report, "hands"))


def _row(drawing: Drawing) -> MotionRow:
    return score(trial(drawing))


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
