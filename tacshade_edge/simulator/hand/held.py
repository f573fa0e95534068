"""Fingers that hold a moving object: the load, slip and skin of each finger.

Pressure and traction of each contact are those of `skin` and `drag`: Coulomb's law holds at every node, and the hand
needs no other law. Loads are in skin units (`load`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tacshade_edge.rigid import Rigid, shift
from tacshade_edge.simulator.drag import loads_of, slip_of
from tacshade_edge.simulator.hand.placed import Grip, contact_centre, moved_along, press_of, slid_on
from tacshade_edge.simulator.load import Load
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import Shape
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.skin import Skin
from tacshade_edge.types import F64, Slip


class FingerSensor(Protocol):
    """A simulated sensor: `scene.SimulatedSensor`, or one of another family."""

    @property
    def model(self) -> SensorModel:
        """The sensor's parameters."""
        ...

    def skin(self, presses: Sequence[Press] = ()) -> Skin:
        """Shape the skin under presses."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Finger:
    """A sensor at its pose while it holds."""

    name: str
    hand_T_sensor: Rigid
    sensor: FingerSensor


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """The pose of an object, and how far each finger is retracted along its own z axis, away from the object (empty:
    none is).
    """

    hand_T_object: Rigid
    back_mm: tuple[float, ...] = ()

    def hand_T_sensor(self, fingers: Sequence[Finger], k: int) -> Rigid:
        """The pose of finger k in the hand."""
        back_mm = self.back_mm[k] if self.back_mm else 0.0
        return fingers[k].hand_T_sensor @ shift(0.0, 0.0, -back_mm)


@dataclass(frozen=True, slots=True, eq=False)
class FingerTruth:
    """The ground truth of one finger at one time; press, centre of contact, slip and load (along the hand's axes,
    torque about the skin's centre) are None without contact.

    `stuck` is the part of its contact in which the skin moves with the object; 1 without contact. `margin` is 1 minus
    the tangential load over μ times the normal load, where a twist's tractions count by their magnitudes; 0 if the
    contact slides as a whole, or without contact.
    """

    name: str
    hand_T_sensor: Rigid
    press: Press | None = None
    centre_mm: F64 | None = None
    depth_mm: float = 0.0
    stuck: float = 1.0
    slip: Slip | None = None
    margin: float = 0.0
    load: Load | None = None


@dataclass(frozen=True, slots=True, eq=False)
class HandTruth:
    """The ground truth of a hand at one time. `motion` maps the object's points, in the hand's frame, from where they
    were at the first finger's touch to where they are; the identity while nothing touches.
    """

    hand_T_object: Rigid
    motion: Rigid
    fingers: tuple[FingerTruth, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Felt:
    """The contact of one finger, and the state from which the next motion is measured (None while it touches
    nothing).
    """

    truth: FingerTruth
    skin: Skin
    grip: Grip | None


def felt(finger: Finger, hand_T_sensor: Rigid, body: Shape, hand_T_object: Rigid, grip: Grip | None = None) -> Felt:
    """Press an object on a finger at its present pose, with the grip of the previous step; without one, the contact
    begins now. Raises ValueError if the object reaches the middle of the sensor.
    """
    model, now = finger.sensor.model, hand_T_sensor.inverse() @ hand_T_object
    at_mm = contact_centre(body, now, model.skin_radius_mm)
    if at_mm is None:
        return Felt(FingerTruth(finger.name, hand_T_sensor), finger.sensor.skin(), None)
    grip = grip or Grip(now)
    drag = moved_along(grip, now, at_mm)
    press = press_of(body, now, model.skin_radius_mm, at_mm, drag)
    skin = finger.sensor.skin((press,))
    (load,) = loads_of(skin, model, (press,))
    stuck = skin.stuck[0] if skin.stuck else 1.0
    slip = slip_of(stuck)
    truth = FingerTruth(
        name=finger.name,
        hand_T_sensor=hand_T_sensor,
        press=press,
        centre_mm=hand_T_sensor.apply(at_mm),
        depth_mm=float(skin.pressed_mm.max()),
        stuck=stuck,
        slip=slip,
        margin=0.0 if slip is Slip.FULL else load.margin(model.coulomb),
        load=load.turned(hand_T_sensor.rotation),
    )
    return Felt(truth, skin, slid_on(grip, drag, load.surplus))


def follow(fingers: Sequence[Finger], k: int, body: Shape, placements: Iterable[Placement]) -> Iterator[Felt]:
    """Yield the contact of finger k with a moving object; a resting one costs nothing. The distance slid is accurate to
    within one placement.
    """
    last: tuple[Placement, Felt] | None = None
    for placement in placements:
        if last is None or last[0] is not placement:
            hand_T_sensor = placement.hand_T_sensor(fingers, k)
            grip = last[1].grip if last else None
            last = placement, felt(fingers[k], hand_T_sensor, body, placement.hand_T_object, grip)
        yield last[1]


def hold(
    fingers: Sequence[Finger], body: Shape, placements: Sequence[Placement]
) -> Iterator[tuple[HandTruth, list[Skin]]]:
    """Yield the ground truth of the hand and the fingers' skins at each placement in turn."""
    of_each = [follow(fingers, k, body, placements) for k in range(len(fingers))]
    grasped: Rigid | None = None
    for placement, *felts in zip(placements, *of_each, strict=True):
        pose = placement.hand_T_object
        touched = any(each.truth.press for each in felts)
        grasped = (grasped or pose) if touched else None
        motion = pose @ grasped.inverse() if grasped else Rigid(np.eye(3), np.zeros(3))
        yield HandTruth(pose, motion, tuple(each.truth for each in felts)), [each.skin for each in felts]
