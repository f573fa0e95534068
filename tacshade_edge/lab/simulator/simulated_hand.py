"""Fingers that hold a moving object: its path, and the press, load, slip and skin of each finger.

A press states how the object moved since it touched as a drag and a twist: those of the material at
the middle of the contact. What a rotation about an axis along the skin does beside the middle is
neglected (0.05 mm for 5°).
"""

from __future__ import annotations

import functools
import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from tacshade_edge.lab.simulator.press import Press, Shape, polygon
from tacshade_edge.lab.simulator.sensor_model import RIM_HALF_ANGLE_DEG, SensorModel
from tacshade_edge.lab.simulator.skin import Skin, node_directions
from tacshade_edge.rigid import Rigid, shift, turn, turned_rad
from tacshade_edge.types import F64

_ROUNDING_MM = 2.0  # of the edges of objects to hold
_EVERY = 4  # step of the sampled nodes in the skin's grid
_STEPS = 40
_NEAREST = 0.3  # of the skin's radius


def lathed(name: str, outline_mm: Sequence[tuple[float, float]]) -> Shape:
    """A solid of revolution about x from the corners (x, distance from x) of its outline; the
    rounding of convex edges is added around it and removes nothing.
    """
    upper = list(outline_mm)
    profile = polygon([*upper, *((x, -rho) for x, rho in reversed(upper))])

    def sdf(p: F64) -> F64:
        return (profile(p[:, 0], np.hypot(p[:, 1], p[:, 2])) - _ROUNDING_MM).astype(p.dtype)

    return Shape(name, sdf)


@dataclass(frozen=True, slots=True, eq=False)
class Grip:
    """The memory of a finger's contact: the object's pose when it touched, and how far it has slid
    over the skin since, along x and y in mm and about z in degrees.
    """

    sensor_T_object: Rigid
    slid: tuple[float, float, float] = (0.0, 0.0, 0.0)


def contact_centre(body: Shape, sensor_T_object: Rigid, skin_radius_mm: float) -> F64 | None:
    """The centre (3,) of the object's surface inside the undeformed skin, in the sensor frame; None
    without contact, that is, with less than a millimetre of skin.
    """
    directions = _looked_at(skin_radius_mm)
    object_T_sensor = sensor_T_object.inverse()
    inside = np.maximum(-body.sdf(object_T_sensor.apply(directions * skin_radius_mm)), 0)
    if not inside.any():
        return None
    middle = inside @ directions
    middle /= np.linalg.norm(middle)
    t = skin_radius_mm
    # From outside, by distances: the point lies on the object, not on the undeformed skin.
    for _ in range(_STEPS):
        t += float(body.sdf(object_T_sensor.apply(t * middle[None]))[0])
        t = min(max(t, _NEAREST * skin_radius_mm), skin_radius_mm)
    return np.asarray(t * middle)


def moved_along(grip: Grip, now: Rigid, at_mm: F64) -> tuple[float, float, float]:
    """Drag along x and y in mm, and twist in degrees, of the material now at a point (3,)."""
    back = grip.sensor_T_object @ now.inverse()
    x_mm, y_mm = (at_mm - back.apply(at_mm))[:2].tolist()
    # The turn about z that comes nearest to the rotation in the plane of the skin.
    (a, b), (c, d) = back.rotation[:2, :2]
    x, y, turned = grip.slid
    return x_mm - x, y_mm - y, math.degrees(math.atan2(b - c, a + d)) - turned


def slid_on(grip: Grip, drag: tuple[float, float, float], surplus: float) -> Grip:
    """The grip after the object slid by a part of its drag;
    an object that turns back then loads it at once.
    """
    if not surplus:
        return grip
    x, y, turned = (of + surplus * by for of, by in zip(grip.slid, drag, strict=True))
    return replace(grip, slid=(x, y, turned))


def press_of(
    body: Shape, now: Rigid, skin_radius_mm: float, at_mm: F64, drag: tuple[float, float, float]
) -> Press:
    """The object as it lies, as a press of depth 0 at a point (3,) of its contact, with a drag and
    a twist; the origin of such a press lies on the undeformed skin.
    """
    x, y, _ = at_mm.tolist()
    origin = np.array((x, y, math.sqrt(skin_radius_mm**2 - x * x - y * y)))
    object_T_press = now.inverse() @ Rigid(np.eye(3), origin)
    turn, place = object_T_press.rotation.T, object_T_press.translation_mm

    def sdf(points: F64) -> F64:
        return body.sdf(points @ turn.astype(points.dtype) + place.astype(points.dtype))

    along_x, along_y, twist = drag
    return Press(
        Shape(body.name, sdf), x, y, 0.0, drag_x_mm=along_x, drag_y_mm=along_y, twist_deg=twist
    )


@functools.lru_cache(maxsize=8)
def _looked_at(skin_radius_mm: float) -> F64:
    """Unit vectors (N, 3) of the skin inside its rim."""
    every = node_directions(skin_radius_mm)[::_EVERY, ::_EVERY].reshape(-1, 3)
    return every[every[:, 2] > math.cos(math.radians(RIM_HALF_ANGLE_DEG))].astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class HandScript:
    """Knots of the path of an object and of the fingers at increasing times; all moves straight and
    steadily between two knots, and rests before the first and after the last.
    """

    times_s: tuple[float, ...]
    placements: tuple[Placement, ...]

    def __post_init__(self) -> None:
        """Raise ValueError for times that do not increase or do not match the placements."""
        if len(self.times_s) != len(self.placements) or not self.times_s:
            raise ValueError(
                f"{len(self.times_s)} times for {len(self.placements)} placements, expected as many"
            )
        if not all(np.diff(self.times_s) > 0) or not math.isfinite(
            self.times_s[-1] - self.times_s[0]
        ):
            raise ValueError(f"times_s is {self.times_s}, expected increasing numbers")

    def held(self, for_s: float) -> HandScript:
        """Append a rest."""
        return self._then(for_s, self.placements[-1])

    def fingers_back(self, back_mm: Sequence[float], for_s: float) -> HandScript:
        """Append a motion of the fingers to the retraction `back_mm`."""
        return self._then(for_s, replace(self.placements[-1], back_mm=tuple(back_mm)))

    def moved(self, hand_T_object: Rigid, for_s: float) -> HandScript:
        """Append a motion of the object to a pose."""
        return self._then(for_s, replace(self.placements[-1], hand_T_object=hand_T_object))

    def at(self, t_s: float) -> Placement:
        """The placement at a time; the same value while everything rests."""
        k = bisect_right(self.times_s, t_s)
        one, other = (
            self.placements[max(k - 1, 0)],
            self.placements[min(k, len(self.placements) - 1)],
        )
        if one is other:
            return one
        part = (t_s - self.times_s[k - 1]) / (self.times_s[k] - self.times_s[k - 1])
        a, b = one.hand_T_object, other.hand_T_object
        # Along the shortest turn, at a steady rate.
        rotation = a.rotation @ turn(part * turned_rad(a.rotation.T @ b.rotation)).rotation
        pose = Rigid(rotation, a.translation_mm + part * (b.translation_mm - a.translation_mm))
        return Placement(
            pose, tuple(p + part * (q - p) for p, q in zip(one.back_mm, other.back_mm, strict=True))
        )

    def _then(self, for_s: float, placement: Placement) -> HandScript:
        return HandScript((*self.times_s, self.times_s[-1] + for_s), (*self.placements, placement))


class FingerSensor(Protocol):
    """A simulated sensor: `truth.SimulatedSensor`, or one of another family."""

    @property
    def model(self) -> SensorModel:
        """The sensor's parameters."""
        ...

    def skin(self, presses: Sequence[Press] = ()) -> Skin:
        """Shape the skin under presses."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedFinger:
    """A sensor at its pose while it holds."""

    name: str
    hand_T_sensor: Rigid
    sensor: FingerSensor


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """An object's pose, and how far each finger is retracted along its z axis,
    away from the object (empty: none).
    """

    hand_T_object: Rigid
    back_mm: tuple[float, ...] = ()

    def hand_T_sensor(self, fingers: Sequence[SimulatedFinger], k: int) -> Rigid:
        """The pose of finger k in the hand."""
        back_mm = self.back_mm[k] if self.back_mm else 0.0
        return fingers[k].hand_T_sensor @ shift(0.0, 0.0, -back_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Felt:
    """One finger's press and skin, and the state from which the next motion is measured;
    None without contact.
    """

    press: Press | None
    skin: Skin
    grip: Grip | None


def felt(
    finger: SimulatedFinger,
    hand_T_sensor: Rigid,
    body: Shape,
    hand_T_object: Rigid,
    grip: Grip | None = None,
) -> Felt:
    """Press an object on a finger at its present pose, with the grip of the previous step; without
    one, the contact begins now.

    Raises ValueError if the object reaches the middle of the sensor.
    """
    radius_mm, now = finger.sensor.model.skin_radius_mm, hand_T_sensor.inverse() @ hand_T_object
    at_mm = contact_centre(body, now, radius_mm)
    if at_mm is None:
        return Felt(None, finger.sensor.skin(), None)
    grip = grip or Grip(now)
    drag = moved_along(grip, now, at_mm)
    press = press_of(body, now, radius_mm, at_mm, drag)
    skin = finger.sensor.skin((press,))
    return Felt(press, skin, slid_on(grip, drag, skin.surplus[0] if skin.surplus else 0.0))


def follow(
    fingers: Sequence[SimulatedFinger], k: int, body: Shape, placements: Iterable[Placement]
) -> Iterator[Felt]:
    """Yield the contact of finger k with a moving object; a resting one costs nothing.

    The distance slid is accurate to within one placement.
    """
    last: tuple[Placement, Felt] | None = None
    for placement in placements:
        # By identity: `HandScript.at` returns the same placement while everything rests.
        if last is None or last[0] is not placement:
            hand_T_sensor = placement.hand_T_sensor(fingers, k)
            grip = last[1].grip if last else None
            last = placement, felt(fingers[k], hand_T_sensor, body, placement.hand_T_object, grip)
        yield last[1]
