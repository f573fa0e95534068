"""A source of trials without pictures: grasps from geometry, with errors as measured on simulated skins."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import numpy as np

from tacshade_edge.core.hand.patch import Patch
from tacshade_edge.rigid import Rigid, turn
from tacshade_edge.types import F64
from tools.studies.object_motion.trial import Moment, Trial

FPS: Final = 60
MOVES_S, HELD_S = 1.5, 0.5
SKIN_RADIUS_MM: Final = 20.0
FARTHEST_MM: Final = 2.5
"""Greatest motion of the patch that moves furthest."""
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
    """Errors of one family of sensors: standard deviations of normal errors, or means where the name says so.

    Attributes
    ----------
    gain_mean, gain_hand, gain : float
        Relative error of shear along the motion: common to all, common to a hand's fingers, and of each contact.
    across : float
        Error of shear across the motion, per mm of motion.
    sunk_mm : float
        Error of depth once a patch has moved by some mm.
    twist_gain_mean, twist_gain : float
        Relative error of twist: common to all, and of each contact.
    frame_shear_mm, frame_depth_mm, frame_deg : float
        Errors of shear, depth and twist that are independent in each frame.
    slow_mm, slow_deg : float
        Errors of shear and depth, and of twist, that change with a time constant of `SLOW_S`.
    """

    gain_mean: float
    gain_hand: float
    gain: float
    across: float
    sunk_mm: float
    twist_gain_mean: float
    twist_gain: float
    frame_shear_mm: float = 0.01
    frame_depth_mm: float = 0.05
    frame_deg: float = 0.1
    slow_mm: float = 0.02
    slow_deg: float = 0.1


SLOW_S: Final = 5.0
SKINS: Final = {
    "tacshade": Skin(-0.12, 0.04, 0.12, 0.05, 0.28, -0.2, 0.3),
    "other": Skin(-0.02, 0.08, 0.14, 0.11, 0.35, -0.7, 0.3),
}
"""Measured by ``python -m tools.studies.drag --profile balanced --sensors default,other:31 --objects ball,cube`` with
drags of 1 to 3 mm: found against true shear, and found depth against the found depth of the same press undragged."""


@dataclass(frozen=True, slots=True)
class Plan:
    """The parameters of the trials; equal plans give equal trials."""

    trials: int = 20
    fingers: tuple[int, ...] = (2, 3, 5)
    objects: tuple[str, ...] = OBJECTS
    skins: tuple[str, ...] = tuple(SKINS)
    events: tuple[str, ...] = EVENTS
    rest_s: float = 600.0


def trials(plan: Plan) -> Iterator[Trial]:
    """Make trials of every event with every object, number of fingers and skin, then trials of objects at rest."""
    for event, what, count, skin, k in product(plan.events, plan.objects, plan.fingers, plan.skins, range(plan.trials)):
        rng = np.random.default_rng((EVENTS.index(event), OBJECTS.index(what), count, list(SKINS).index(skin), k))
        yield _trial(what, count, skin, event, rng)
    for event, what in product(("rests", "rests, a finger comes and goes"), plan.objects):
        rng = np.random.default_rng((len(EVENTS), OBJECTS.index(what)))
        grasp = _Grasp.drawn(what, 5, rng)
        moments = _resting(grasp, SKINS["tacshade"], round(plan.rest_s * FPS), event != "rests", rng)
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
