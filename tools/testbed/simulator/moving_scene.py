"""A simulated sensor over time: objects that move, a creeping skin, and the truth.

Every result depends only on the time in seconds, so times may come in any order.

The skin creeps and recovers as a standard linear solid: a spring in series with a parallel spring
and dashpot (Zener, Elasticity and Anelasticity of Metals, 1948; Findley, Lai and Onaran, Creep and
Relaxation of Nonlinear Viscoelastic Materials, 1976, ch. 5). With u the immediate deformation under
a load, the second spring's e follows τ e' = c u - e, so

    e(t) = c/τ ∫ u(s) exp(-(t - s)/τ) ds.

Under a constant load, u grows to u (1 + c (1 - exp(-t/τ))). After the load is gone, e remains and
decays by exp(-t/τ), from at most c / (1 + c) of the depth. Membrane and foundation of the skin are
assumed to be the same solid. Then e is a shape without forces, and contact with the skin is elastic
contact with a skin of this shape: the correspondence of Lee and Radok (J. Appl. Mech. 27, 1960),
here for any history. Along the skin, u is an object's drag, of which the motion is given instead of
the load; this causes a relative difference of c².
"""

from __future__ import annotations

import functools
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np

from tacshade_edge.lab.simulator.drag import contact_nodes
from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.render import Renderer
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import Skin, node_directions, undeformed
from tacshade_edge.lab.simulator.truth import SimulatedFrame, skin_under
from tacshade_edge.types import F32, F64, Slip

_INVERSE_STEPS = 24


STICKS = 0.9
"""Least part of a contact that moves with the object if it sticks:
the outermost ring of any contact slides.
"""
SLIDES = 0.02
"""Greatest part of a contact that moves with the object if it slides as a whole."""


def slip_of(stuck: float) -> Slip:
    """The slip of a contact, from `Skin.stuck`."""
    return Slip.STICK if stuck >= STICKS else Slip.FULL if stuck <= SLIDES else Slip.PARTIAL


def kept(times_s: Sequence[float], t_s: float, creep_part: float, creep_s: float) -> F64:
    """Compute the weights (K,) of a history's knots: e(t) is the weighted sum of u at the knots;
    `creep_part` is c.

    u is linear between two knots, and 0 before the first and after the last. Weights are at least
    0, and their sum is at most `creep_part`.
    """
    times, weights = np.asarray(times_s, np.float64), np.zeros(len(times_s))
    begin = times[:-1][times[:-1] < t_s]
    length = times[1 : len(begin) + 1] - begin
    end = np.minimum(begin + length, t_s)
    early, late = np.exp((begin - t_s) / creep_s), np.exp((end - t_s) / creep_s)
    later = (
        late * (end - begin - creep_s) + early * creep_s
    ) / length  # ∫ (s - begin) / length exp(..) ds / τ
    weights[: len(begin)] += late - early - later
    weights[1 : len(begin) + 1] += later
    return np.asarray(creep_part * np.maximum(weights, 0))


@dataclass(frozen=True, slots=True, eq=False)
class Imprint:
    """The skin's immediate deformation under a load, which the material remembers.

    `pressed_mm` (2n+1, 2n+1) is the h that objects cause,
    at the places where the material was without drag.
    """

    skin: Skin
    pressed_mm: F32


def imprint(skin: Skin) -> Imprint:
    """Compute the imprint of an elastic skin."""
    if skin.origin_mm is None:
        return Imprint(skin, skin.pressed_mm)
    origin = skin.origin_mm / np.float32(skin.step_mm)
    before = _nodes(len(origin))
    now = before.copy()
    for _ in range(_INVERSE_STEPS):  # this converges, because `drag` lets no skin fold
        now = before - _sampled(origin, now)
    return Imprint(skin, _sampled(skin.pressed_mm, now))


def rest(
    imprints: Sequence[Imprint], weights: Sequence[float], radius_mm: float, origin_mm: F32 | None
) -> Skin:
    """Compute the shape without forces, which is e at every node, from weights of `kept`.

    `origin_mm` is the present `Skin.origin_mm`, by which the material moves its dent.
    """
    flat = undeformed(radius_mm)
    pressed, leaning = np.zeros_like(flat.height_mm), np.zeros_like(flat.height_mm)
    origin = np.zeros((*pressed.shape, 2), np.float32)
    for each, weight in zip(imprints, np.asarray(weights, np.float32), strict=True):
        pressed += weight * each.pressed_mm
        if each.skin.leaning_mm is not None:
            leaning += weight * each.skin.leaning_mm
        if each.skin.origin_mm is not None:
            origin += weight * each.skin.origin_mm
    if origin_mm is not None:
        pressed = _sampled(pressed, _nodes(len(pressed)) + origin_mm / np.float32(flat.step_mm))
    left = replace(flat, height_mm=pressed, origin_mm=origin if origin.any() else None)
    return left.leaning(leaning if leaning.any() else None)


def _nodes(size: int) -> F32:
    """Make the column and row of every node, (size, size, 2)."""
    axis = np.arange(size, dtype=np.float32)
    return np.stack(np.meshgrid(axis, axis), axis=-1)


def _sampled(grid: F32, at: F32) -> F32:
    """Sample a grid at columns and rows (.., 2), precise to a 32nd of a step; 0 outside."""
    return np.asarray(
        cv2.remap(grid, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.float32
    )


CLEAR_MM = 1.0
"""Height above the skin at which a motion begins and ends."""

_LEVER_MM = 5.0  # converts a turn to a motion
_NUMBERS = tuple(field.name for field in fields(Press) if field.name != "shape")


@dataclass(frozen=True, slots=True)
class Motion:
    """The knots of an object's path, which is linear between two knots;
    before and after, the object is absent.

    Presses are of one shape; `depth_mm` is the immediate depth under the load:
    into a creeping skin, it sinks further.
    """

    times_s: tuple[float, ...]
    presses: tuple[Press, ...]

    def __post_init__(self) -> None:
        """Refuse times that do not increase, and an object whose shape changes."""
        if len(self.times_s) != len(self.presses) or len(self.times_s) < 2:
            raise ValueError(
                f"{len(self.times_s)} times for {len(self.presses)} presses, "
                "expected two or more of each"
            )
        if not all(np.diff(self.times_s) > 0) or not math.isfinite(
            self.times_s[-1] - self.times_s[0]
        ):
            raise ValueError(f"times_s is {self.times_s}, expected increasing numbers")
        if any(press.shape is not self.presses[0].shape for press in self.presses):
            raise ValueError("presses of several shapes, expected one object")

    def held(self, for_s: float) -> Motion:
        """Add a time in which the object stays."""
        return self._then(for_s, self.presses[-1])

    def dragged(self, x_mm: float, y_mm: float, speed_mm_s: float) -> Motion:
        """Add a drag along the skin."""
        last = self.presses[-1]
        moved = replace(
            last,
            x_mm=last.x_mm + x_mm,
            y_mm=last.y_mm + y_mm,
            drag_x_mm=last.drag_x_mm + x_mm,
            drag_y_mm=last.drag_y_mm + y_mm,
        )
        return self._then(math.hypot(x_mm, y_mm) / speed_mm_s, moved)

    def released(self, speed_mm_s: float) -> Motion:
        """Add a release along z."""
        last = self.presses[-1]
        up = self._then(last.depth_mm / speed_mm_s, replace(last, depth_mm=0.0))
        return up._then(CLEAR_MM / speed_mm_s, replace(last, depth_mm=-CLEAR_MM))

    def at(self, t_s: float) -> Press | None:
        """Compute the press at a time; None while the object is absent."""
        if not self.times_s[0] <= t_s <= self.times_s[-1]:
            return None
        k = min(bisect_right(self.times_s, t_s), len(self.times_s) - 1) - 1
        one, other = self.presses[k : k + 2]
        part = (t_s - self.times_s[k]) / (self.times_s[k + 1] - self.times_s[k])
        between = {
            name: a + part * (b - a)
            for name in _NUMBERS
            if (a := getattr(one, name)) != (b := getattr(other, name))
        }
        return replace(one, **between) if between else one

    def steps_s(self, step_mm: float) -> tuple[float, ...]:
        """List the knots' times, and times in between so that the object moves
        by at most a step between two times.
        """
        times = [self.times_s[0]]
        for k, (one, other) in enumerate(zip(self.presses[:-1], self.presses[1:], strict=True)):
            along = math.hypot(
                other.x_mm - one.x_mm, other.y_mm - one.y_mm, other.depth_mm - one.depth_mm
            )
            turned = math.radians(abs(other.rotation_deg - one.rotation_deg)) * _LEVER_MM
            parts = max(1, math.ceil((along + turned) / step_mm))
            times.extend(np.linspace(self.times_s[k], self.times_s[k + 1], parts + 1)[1:].tolist())
        return tuple(times)

    def _then(self, for_s: float, press: Press) -> Motion:
        return Motion((*self.times_s, self.times_s[-1] + for_s), (*self.presses, press))


def pressed(press: Press, start_s: float, speed_mm_s: float) -> Motion:
    """Make a motion in which an object comes down along z from above the skin to a press."""
    touches_s = start_s + CLEAR_MM / speed_mm_s
    return Motion(
        (start_s, touches_s, touches_s + press.depth_mm / speed_mm_s),
        (replace(press, depth_mm=-CLEAR_MM), replace(press, depth_mm=0.0), press),
    )


_MEMORY_STEP_MM = 1.0
_JUMP_S = 1e-6
_ROUND_MM = 3  # digits, so that a skin that has stopped creeping is drawn once
_ROUND_PART = 4
_SPEED_SPAN_S = 0.02


@dataclass(frozen=True, slots=True)
class ObjectState:
    """The state of an object at one time; `press` is None while it is absent.

    `stuck` is the part of its contact in which the skin moves with it (1 without a contact); `slip`
    is full if the whole contact slides, or slid and then came to rest; `slip_mm_s` is relative to
    the skin, averaged over the contact.
    """

    press: Press | None
    touches: bool = False
    stuck: float = 1.0
    slip: Slip | None = None
    slip_mm_s: float = 0.0


@dataclass(frozen=True, slots=True)
class _Moment:
    """Everything that determines the skin's shape; equal moments have equal skins.

    `loads` and `presses` are the present objects at their depths without and with creep, of the
    motions `owners`; `memory` are earlier loads, and the part of each that remains.
    """

    loads: tuple[Press, ...]
    presses: tuple[Press, ...]
    owners: tuple[int, ...]
    memory: tuple[tuple[tuple[Press, ...], float], ...]


class MovingScene:
    """Objects on a sensor, over time. Equal time and noise seed give equal frames."""

    def __init__(self, motions: Sequence[Motion], model: SensorModel | None = None) -> None:
        self.model = model or SensorModel()
        self.motions = tuple(motions)
        self._renderer = Renderer(self.model)
        times = set[float]()
        for motion in self.motions:
            times.update(motion.steps_s(_MEMORY_STEP_MM))
            times.update((motion.times_s[0] - _JUMP_S, motion.times_s[-1] + _JUMP_S))
        self._times_s = tuple(sorted(times))
        self._loads = tuple(tuple(motion.at(t) for motion in self.motions) for t in self._times_s)
        self._skin = functools.lru_cache(maxsize=8)(self._shaped)
        self._elastic = functools.lru_cache(maxsize=64)(self._imprint)
        self._drawn = functools.lru_cache(maxsize=2)(self._drawing)

    def skin(self, t_s: float) -> Skin:
        """Compute the skin's shape at a time."""
        return self._skin(self._moment(t_s))

    def frame(self, t_s: float, noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture.

        Raises ValueError: a press is not over the skin, or reaches the sensor's middle.
        """
        moment = self._moment(t_s)
        return SimulatedFrame(
            self._renderer.expose(self._drawn(moment), noise_seed),
            moment.presses,
            self._skin(moment),
            self.model,
        )

    def objects(self, t_s: float) -> tuple[ObjectState, ...]:
        """Compute the true state of each motion's object, which takes as long as three frames."""
        times = tuple(t_s + k * _SPEED_SPAN_S for k in (-1, 0, 1))
        moments = [self._moment(t) for t in times]
        touching = [self._touching(moment) for moment in moments]
        states = []
        for k in range(len(self.motions)):
            press, stuck, slip, speed = None, 1.0, None, 0.0
            if k in moments[1].owners:
                press = moments[1].presses[moments[1].owners.index(k)]
            if k in touching[1]:
                seen = [
                    (t, self._slid_mm(m, k))
                    for t, m, on in zip(times, moments, touching, strict=True)
                    if k in on
                ]
                if len(seen) > 1:
                    speed = math.dist(seen[0][1], seen[-1][1]) / (seen[-1][0] - seen[0][0])
                stuck = self._stuck(moments[1], k)
                slip = slip_of(stuck)
            states.append(ObjectState(press, k in touching[1], stuck, slip, speed))
        return tuple(states)

    def _moment(self, t_s: float) -> _Moment:
        model = self.model
        weights = kept(self._times_s, t_s, model.creep_part, model.creep_s).tolist()
        loads, presses, owners = [], [], []
        for k, motion in enumerate(self.motions):
            load = motion.at(t_s)
            if load is not None:
                before = zip(weights, (then[k] for then in self._loads), strict=True)
                sunk = sum(w * max(press.depth_mm, 0.0) for w, press in before if press is not None)
                loads.append(load)
                presses.append(replace(load, depth_mm=load.depth_mm + round(sunk, _ROUND_MM)))
                owners.append(k)
        left = dict[tuple[Press, ...], float]()
        for weight, at in zip(weights, self._loads, strict=True):
            there = tuple(press for press in at if press is not None)
            left[there] = left.get(there, 0.0) + weight
        memory = tuple(
            (there, part)
            for there, w in left.items()
            if there and (part := round(w, _ROUND_PART)) > 0
        )
        return _Moment(tuple(loads), tuple(presses), tuple(owners), memory)

    def _shaped(self, moment: _Moment) -> Skin:
        if not moment.memory:
            return skin_under(self.model, moment.presses)
        dragged = any(press.is_dragged for press in moment.loads)
        origin_mm = self._elastic(moment.loads).skin.origin_mm if dragged else None
        imprints = [self._elastic(loads) for loads, _ in moment.memory]
        left = rest(
            imprints, [part for _, part in moment.memory], self.model.skin_radius_mm, origin_mm
        )
        return skin_under(self.model, moment.presses, left)

    def _imprint(self, loads: tuple[Press, ...]) -> Imprint:
        return imprint(skin_under(self.model, loads))

    def _drawing(self, moment: _Moment) -> F32:
        return self._renderer.draw(self._skin(moment))

    def _touching(self, moment: _Moment) -> set[int]:
        skin = self._skin(moment)
        owner = contact_nodes(skin, node_directions(skin.radius_mm), moment.presses)[2]
        return {moment.owners[k] for k in set(owner.tolist())}

    def _slid_mm(self, moment: _Moment, k: int) -> tuple[float, float]:
        slid_mm = self._skin(moment).slid_mm
        return slid_mm[moment.owners.index(k)] if slid_mm else (0.0, 0.0)

    def _stuck(self, moment: _Moment, k: int) -> float:
        stuck = self._skin(moment).stuck
        return stuck[moment.owners.index(k)] if stuck else 1.0
