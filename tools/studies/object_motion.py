"""How well a hand knows the motion of the object that it holds.

::

    .venv/bin/python -m tools.studies.object_motion [--trials 20] [--rest-s 600] [--csv FILE]
    .venv/bin/python -m tools.studies.object_motion --drawn 3 [--final] [--csv FILE]

The first command takes grasps from geometry, with errors of patches as measured before. In the second, a simulated hand
holds an object, and the study draws and reconstructs the pictures of all five fingers, which takes a minute of one core
per trial.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Final, cast

import numpy as np

from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.core.contact.tracking import ContactTracker
from tacshade_edge.core.hand.link import Patch
from tacshade_edge.core.hand.object_motion import ObjectMotion, ObjectTracker
from tacshade_edge.core.reconstruct import step_and_track
from tacshade_edge.hand import patches_of
from tacshade_edge.protocol.hand import finger_of
from tacshade_edge.rigid import Rigid, turn, turned_rad
from tacshade_edge.simulator.hand import HandScript, Placement, box, cylinder, sphere
from tacshade_edge.simulator.press import Shape
from tacshade_edge.studies.evaluate.sensors import calibrated, reconstructor
from tacshade_edge.studies.parallel import Report, Workers, reported_map, workers
from tacshade_edge.studies.tables import csv_text, grouped, summary
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
    """A grasp over time, by at most so many fingers.

    Errors and jumps are measured at `points_mm` (n, 3) of the object in the hand's frame, its middle first.
    """

    object: str
    skin: str
    event: str
    fingers: int
    points_mm: F64
    moments: Iterable[Moment]


# Grasps from geometry.

FPS: Final = 60
MOVES_S, HELD_S = 1.5, 0.5
SKIN_RADIUS_MM: Final = 20.0
DEPTHS_MM: Final = (0.4, 5.0)
"""Range of depths; motions in which a finger would leave this range are drawn again."""
OBJECTS: Final = ("box", "cylinder", "ball")
EVENTS: Final = ("moves", "a finger leaves", "a finger joins", "a finger slips")
LEAN_DEG: Final = 25.0
"""Greatest angle between a contact and its finger's tip."""
SLIP_SEEN_S: Final = (0.07, 0.15)
"""Time from the start of a slip to its report (docs/how-to/shear.md)."""


@dataclass(frozen=True, slots=True)
class Skin:
    """Errors of one family of sensors: standard deviations of normal errors, or means where the name says so."""

    gain_mean: float  # relative error of shear along the motion: common to all, to a hand's fingers, of each contact
    gain_hand: float
    gain: float
    across: float  # of shear across the motion, per mm of motion
    sunk_mm: float  # of depth once a patch has moved by some mm
    twist_gain_mean: float  # relative error of twist: common to all, and of each contact
    twist_gain: float
    frame_shear_mm: float = 0.01  # independent in each frame
    frame_depth_mm: float = 0.05
    frame_deg: float = 0.1
    slow_mm: float = 0.02  # of shear and depth, and of twist, that change with a time constant of `SLOW_S`
    slow_deg: float = 0.1


SLOW_S: Final = 5.0
SKINS: Final = {
    "tacshade": Skin(-0.12, 0.04, 0.12, 0.05, 0.28, -0.2, 0.3),
    "other": Skin(-0.02, 0.08, 0.14, 0.11, 0.35, -0.7, 0.3),
}
"""Measured by ``python -m tools.studies.drag --profile balanced --sensors default,other:31 --objects ball,cube`` with
drags of 1 to 3 mm: found against true shear, and found depth against the found depth of the same press undragged."""


def trials(count: int, rest_s: float) -> Iterator[Trial]:
    """Make trials of every event with every object, number of fingers and skin, then trials of objects at rest."""
    for event, what, fingers, skin, k in product(EVENTS, OBJECTS, (2, 3, 5), SKINS, range(count)):
        rng = np.random.default_rng((EVENTS.index(event), OBJECTS.index(what), fingers, list(SKINS).index(skin), k))
        yield _trial(what, fingers, skin, event, rng)
    for event, what in product(("rests", "rests, a finger comes and goes"), OBJECTS):
        rng = np.random.default_rng((len(EVENTS), OBJECTS.index(what)))
        grasp = _Grasp.drawn(what, 5, rng)
        moments = _resting(grasp, SKINS["tacshade"], round(rest_s * FPS), event != "rests", rng)
        yield Trial(what, "tacshade", event, 5, grasp.points_mm(), moments)


def _trial(what: str, count: int, skin: str, event: str, rng: np.random.Generator) -> Trial:
    while True:
        grasp = _Grasp.drawn(what, count, rng)
        rotation_rad, translation_mm = _motion(grasp, rng)
        ends = [_at(finger, _moved(grasp, rotation_rad, translation_mm, 1.0)).depth_mm for finger in grasp.fingers]
        if all(DEPTHS_MM[0] < depth_mm < DEPTHS_MM[1] for depth_mm in ends):
            break
    moments = tuple(_moments(grasp, SKINS[skin], event, rotation_rad, translation_mm, rng))
    return Trial(what, skin, event, count, grasp.points_mm(), moments)


@dataclass(frozen=True, slots=True, eq=False)
class _Finger:
    """A finger when it begins to touch: its dome's centre, and the patch that it would report without an error."""

    centre_mm: F64
    patch: Patch


@dataclass(frozen=True, slots=True, eq=False)
class _Grasp:
    fingers: tuple[_Finger, ...]

    @classmethod
    def drawn(cls, what: str, count: int, rng: np.random.Generator) -> _Grasp:
        """Draw a grasp with a thumb on one side and the other fingers on the opposite side."""
        middle_mm = rng.uniform(-60, 60, 3)
        across = math.pi + np.array([0.0, *(np.linspace(-0.8, 0.8, count + 1)[1:-1] + math.pi)])
        along_mm = np.array([0.0, *rng.permutation(np.linspace(-20, 20, count + 1)[1:-1])])
        return cls(
            tuple(
                _finger(what, float(a + rng.normal(0, 0.1)), float(z + rng.normal(0, 3)), middle_mm, rng)
                for a, z in zip(across, along_mm, strict=True)
            )
        )

    def points_mm(self) -> F64:
        """Return points of the object: the middle of all patches, then the place of each."""
        places = np.array([finger.patch.place_mm for finger in self.fingers])
        return np.vstack((places.mean(axis=0), places))


def _finger(what: str, angle: float, along_mm: float, middle_mm: F64, rng: np.random.Generator) -> _Finger:
    c, s = math.cos(angle), math.sin(angle)
    if what == "box":
        place = np.array((math.copysign(18.0, c), 20.0 * s, along_mm))
        outward = np.array((math.copysign(1.0, c), 0.0, 0.0))
    elif what == "cylinder":
        place, outward = np.array((18.0 * c, 18.0 * s, along_mm)), np.array((c, s, 0.0))
    else:
        outward = np.array((c, s, along_mm / 25.0))
        outward /= np.linalg.norm(outward)
        place = 22.0 * outward
    normal = -outward
    lean = rng.uniform(0, math.radians(LEAN_DEG))
    side = np.cross(normal, rng.normal(size=3))
    axis = turn(lean * side / np.linalg.norm(side)).rotation @ normal
    depth_mm = rng.uniform(1.8, 3.0)
    place = place + middle_mm
    shear = rng.normal(0, 0.3, 3)
    shear -= axis * (axis @ shear)
    patch = Patch(_three(place), _three(normal), _three(axis), _three(shear), depth_mm, float(rng.normal(0, 3)))
    return _Finger(place - (SKIN_RADIUS_MM - depth_mm) * normal, patch)


def _motion(grasp: _Grasp, rng: np.random.Generator) -> tuple[F64, F64]:
    """Draw a rotation about the grasp's middle and a translation, in any ratio of the two."""
    middle, *places = grasp.points_mm()
    share = rng.uniform()
    translation, rotation = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    translation, rotation = translation * share, rotation * (1 - share) / 20.0
    farthest = max(float(np.linalg.norm(translation + np.cross(rotation, place - middle))) for place in places)
    size = rng.uniform(0.2, FARTHEST_MM) / farthest
    return rotation * size, translation * size


def _moved(grasp: _Grasp, rotation_rad: F64, translation_mm: F64, part: float) -> Rigid:
    middle_mm = grasp.points_mm()[0]
    turned = turn(part * rotation_rad).rotation
    return Rigid(turned, middle_mm + part * translation_mm - turned @ middle_mm)


def _at(finger: _Finger, moved: Rigid) -> Patch:
    """Compute the patch that a sticking finger would report without an error."""
    first = finger.patch
    place, axis, normal = (np.array(v) for v in (first.place_mm, first.axis, first.normal))
    now = moved.apply(place)
    way = now - place
    radial = now - finger.centre_mm
    rim = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    rim = 3.0 * np.array([turn(a * normal).rotation @ rim / np.linalg.norm(rim) for a in np.arange(8) * math.pi / 4])
    x = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    plane = np.array((x / np.linalg.norm(x), np.cross(axis, x / np.linalg.norm(x))))
    before, after = rim @ plane.T, (rim @ moved.rotation.T) @ plane.T
    sine = (before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]).sum()
    twist_deg = math.degrees(math.atan2(sine, (before * after).sum()))
    assert first.twist_deg is not None
    return replace(
        first,
        place_mm=_three(now),
        normal=_three(radial / np.linalg.norm(radial)),
        shear_mm=_three(np.array(first.shear_mm) + way - axis * (axis @ way)),
        depth_mm=float(SKIN_RADIUS_MM - np.linalg.norm(radial)),
        twist_deg=first.twist_deg + twist_deg,
    )


class _Errors:
    """The errors of one finger's contact."""

    def __init__(self, skin: Skin, gain_hand: float, rng: np.random.Generator) -> None:
        self._skin, self._rng = skin, rng
        self._gain = skin.gain_mean + gain_hand + rng.normal(0, skin.gain)
        self._across = rng.normal(0, skin.across)
        self._sunk_mm = rng.normal(0, skin.sunk_mm)
        self._twist_gain = skin.twist_gain_mean + rng.normal(0, skin.twist_gain)
        self._slow = rng.normal(size=5)

    def added(self, first: Patch, now: Patch) -> Patch:
        """Add the errors to the patch that an exact finger would report."""
        skin, rng = self._skin, self._rng
        keep = math.exp(-1 / (FPS * SLOW_S))
        self._slow = keep * self._slow + math.sqrt(1 - keep * keep) * rng.normal(size=5)
        axis, shear = np.array(now.axis), np.array(now.shear_mm)
        way = shear - np.array(first.shear_mm)
        jitter = skin.slow_mm * self._slow[:3] + rng.normal(0, skin.frame_shear_mm, 3)
        error = self._gain * way + self._across * np.cross(axis, way) + jitter - axis * (axis @ jitter)
        far = 1 - math.exp(-float(np.linalg.norm(way)) / 0.5)
        sunk_mm = self._sunk_mm * far + skin.slow_mm * self._slow[3] + rng.normal(0, skin.frame_depth_mm)
        assert now.twist_deg is not None
        assert first.twist_deg is not None
        twist_deg = self._twist_gain * (now.twist_deg - first.twist_deg) + skin.slow_deg * self._slow[4]
        return replace(
            now,
            shear_mm=_three(shear + error),
            depth_mm=now.depth_mm + float(sunk_mm),
            twist_deg=now.twist_deg + float(twist_deg + rng.normal(0, skin.frame_deg)),
        )


def _moments(
    grasp: _Grasp, skin: Skin, event: str, rotation_rad: F64, translation_mm: F64, rng: np.random.Generator
) -> Iterator[Moment]:
    last = len(grasp.fingers) - 1
    gain_hand = rng.normal(0, skin.gain_hand)
    errors = [_Errors(skin, gain_hand, rng) for _ in grasp.fingers]
    changed = round(FPS * MOVES_S * rng.uniform(0.3, 0.7))
    told = changed + round(FPS * rng.uniform(*SLIP_SEEN_S))
    fingers, held = list(grasp.fingers), None
    for k in range(round(FPS * (MOVES_S + HELD_S))):
        s = min(1.0, k / (FPS * MOVES_S))
        moved = _moved(grasp, rotation_rad, translation_mm, s * s * (3 - 2 * s))
        patches = {}
        for i, finger in enumerate(fingers):
            now = _at(finger, moved)
            if i == last and event == "a finger leaves" and k >= changed:
                continue
            if i == last and event == "a finger joins":
                if k < changed:
                    continue
                if k == changed:  # the new finger's skin is undragged, and its patch lies where the object is now
                    place, normal = np.array(now.place_mm), np.array(now.normal)
                    rest = replace(finger.patch, place_mm=now.place_mm, normal=now.normal, shear_mm=(0, 0, 0))
                    centre_mm = place - (SKIN_RADIUS_MM - finger.patch.depth_mm) * normal
                    fingers[i] = finger = _Finger(centre_mm, replace(rest, twist_deg=0.0))
                    joined_at = moved.inverse()
                now = _at(finger, moved @ joined_at)
            if i == last and event == "a finger slips" and k >= changed:
                held = held or now
                now = replace(now, shear_mm=held.shear_mm, twist_deg=held.twist_deg, slips=k >= told)
            patches[f"{i}"] = errors[i].added(finger.patch, now)
        yield Moment(round(1e9 * k / FPS), patches, moved)


def _resting(grasp: _Grasp, skin: Skin, frames: int, flickers: bool, rng: np.random.Generator) -> Iterator[Moment]:
    still = Rigid(np.eye(3), np.zeros(3))
    errors = [_Errors(skin, 0.0, rng) for _ in grasp.fingers]
    for k in range(frames):
        there = grasp.fingers[: -1 if flickers and (k // FPS) % 2 else None]
        yield Moment(
            round(1e9 * k / FPS),
            {f"{i}": errors[i].added(finger.patch, finger.patch) for i, finger in enumerate(there)},
            still,
        )


def _three(vector: F64) -> tuple[float, float, float]:
    x, y, z = map(float, vector)
    return x, y, z


# Pictures of a simulated hand.

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

    return Trial(drawing.body, drawing.family, "drawn", 5, np.vstack((middle_mm, points_mm)), moments())


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


# Scores.

CHI2_90: Final = (0.0, 2.706, 4.605, 6.251, 7.779, 9.236, 10.645)
"""90 % quantiles of the chi-squared distribution, by degrees of freedom."""
LEVER_MM: Final = 20.0
ALIKE: Final = 0.2
"""Directions of motion within this sine of an angle count as equal; `LEVER_MM` converts rotations to lengths."""


@dataclass(frozen=True, slots=True)
class MotionRow:
    """The result of a trial; lengths, angles and errors are those at the end."""

    object: str
    skin: str
    event: str
    fingers: int
    patch_mm: float  # true motion of the point that moved furthest
    turned_deg: float
    translation_off_mm: float  # of the object's middle
    rotation_off_deg: float
    ellipsoid: float  # squared error, weighted by the inverse covariance, over the bound of the 90 % ellipsoid
    jump_mm: float  # greatest change of a point's error from one moment to the next
    hidden: int  # directions that the geometry left unobserved at some moment
    named: bool  # whether the tracker reports as many lines, all of them among these directions
    step_ms: float  # on one core


def score(trial: Trial) -> MotionRow:
    """Run the tracker on a trial and score it."""
    tracker = ObjectTracker()
    jump_mm, spent_s, count = 0.0, 0.0, 0
    before: F64 | None = None
    stuck: set[frozenset[str]] = set()
    places: dict[str, tuple[float, float, float]] = {}
    for moment in trial.moments:
        began_s = time.perf_counter()
        found = tracker.step(moment.t_ns, moment.patches)
        spent_s += time.perf_counter() - began_s
        count += 1
        assert found is not None
        stuck.add(frozenset(key for key, patch in moment.patches.items() if not patch.slips))
        places |= {key: patch.place_mm for key, patch in moment.patches.items()}
        error_mm = found.rigid().apply(trial.points_mm) - moment.moved.apply(trial.points_mm)
        if before is not None:
            jump_mm = max(jump_mm, float(np.linalg.norm(error_mm - before, axis=1).max()))
        before = error_mm
    assert before is not None
    assert found is not None
    middle_mm = trial.points_mm[0]
    hidden = _independent(np.vstack([_unseen(np.array([places[key] for key in keys]) - middle_mm) for keys in stuck]))
    left = found.rigid().rotation @ moment.moved.rotation.T
    way_mm = moment.moved.apply(trial.points_mm) - trial.points_mm
    return MotionRow(
        *(trial.object, trial.skin, trial.event, trial.fingers),
        *(float(np.linalg.norm(way_mm, axis=1).max()), _degrees(moment.moved.rotation)),
        *(float(np.linalg.norm(before[0])), _degrees(left), _ellipsoid(found, moment.moved), jump_mm),
        len(hidden),
        _names(found, hidden, middle_mm),
        1000 * spent_s / count,
    )


def _unseen(arms_mm: F64) -> F64:
    """Find the directions (k, 6) of motions that leave all these places where they are."""
    rows = []
    for x, y, z in arms_mm / LEVER_MM:
        rows.append(np.hstack((np.eye(3), ((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0)))))
    _, sizes, directions = np.linalg.svd(np.vstack(rows))
    return np.asarray(directions[np.count_nonzero(sizes > 1e-6) :])


def _independent(directions: F64) -> F64:
    """Find orthogonal directions that span all given directions that differ."""
    _, sizes, alone = np.linalg.svd(directions, full_matrices=False)
    return np.asarray(alone[sizes > ALIKE])


def _names(found: ObjectMotion, hidden: F64, middle_mm: F64) -> bool:
    """Whether the reported lines are all among the hidden directions, and equal in number."""
    for line in found.unobserved:
        if line.through_mm is None:
            return False
        axis = np.array(line.axis)
        direction = np.hstack((np.cross(axis, middle_mm - line.through_mm), LEVER_MM * axis))
        direction /= np.linalg.norm(direction)
        if np.linalg.norm(direction - (direction @ hidden.T) @ hidden) > ALIKE:
            return False
    return len(found.unobserved) == len(hidden)


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


def _of_seen(figure: Callable[[Sequence[MotionRow]], str], some: Sequence[MotionRow]) -> str:
    """A figure of the trials in which the geometry hides nothing."""
    seen = [row for row in some if not row.hidden]
    return figure(seen) if seen else ""


FIGURES: dict[str, Callable[[Sequence[MotionRow]], str]] = {
    "trials": lambda some: str(len(some)),
    "within 0.4 mm and 3° %": partial(_of_seen, lambda some: f"{100 * np.mean([within(row) for row in some]):.0f}"),
    "off mm: median": partial(_of_seen, lambda some: f"{np.median([row.translation_off_mm for row in some]):.2f}"),
    "95 %": partial(_of_seen, lambda some: f"{np.quantile([row.translation_off_mm for row in some], 0.95):.2f}"),
    "off °: median": partial(_of_seen, lambda some: f"{np.median([row.rotation_off_deg for row in some]):.1f}"),
    "off °: 95 %": partial(_of_seen, lambda some: f"{np.quantile([row.rotation_off_deg for row in some], 0.95):.1f}"),
    "in the 90 % ellipsoid %": lambda some: f"{100 * np.mean([row.ellipsoid <= 1 for row in some]):.0f}",
    "unobservable": lambda some: ", ".join(map(str, sorted({row.hidden for row in some}))),
    "named %": lambda some: f"{100 * np.mean([row.named for row in some]):.0f}",
    "jump mm: greatest": lambda some: f"{max(row.jump_mm for row in some):.2f}",
    "ms a step": lambda some: f"{np.mean([row.step_ms for row in some]):.2f}",
}


def text(rows: Sequence[MotionRow]) -> str:
    """A table per event, with rows by number of fingers: for all trials, then for each object and skin."""
    parts = []
    for event, of_event in grouped(rows, "event").items():
        groups: list[tuple[tuple[str, str], Sequence[MotionRow]]] = []
        for count, some in sorted(grouped(of_event, "fingers").items()):
            names = dict.fromkeys(name for row in some for name in (row.object, row.skin))
            by_name = [(name, [row for row in some if name in (row.object, row.skin)]) for name in names]
            groups += [((name, str(count)), of) for name, of in (("all", some), *by_name)]
        parts.append(f"{event.capitalize()}\n\n{summary(('what', 'fingers'), groups, FIGURES)}")
    return "\n\n".join(parts)


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description="Motion of a held object.")
    parser.add_argument("--trials", type=int, default=20, metavar="N", help="of each object, event, skin and grasp")
    parser.add_argument("--rest-s", type=float, default=600.0, metavar="S")
    parser.add_argument("--drawn", type=int, metavar="N", help="pictures instead, so many of each object and family")
    parser.add_argument("--final", action="store_true", help="with --drawn: the sensors kept for final figures")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write a row for each trial")
    args = parser.parse_args(words)
    if args.drawn:
        with command.folder_for(parser, None), workers() as pool:
            chosen = drawings(args.drawn, FINAL_FAMILIES if args.final else FAMILIES)
            rows = drawn_rows(chosen, pool, Progress())
    else:
        rows = [score(trial) for trial in trials(args.trials, args.rest_s)]
    print(text(rows))
    if args.csv:
        args.csv.write_text(csv_text(MotionRow, rows), encoding="utf-8")


if __name__ == "__main__":
    main()
