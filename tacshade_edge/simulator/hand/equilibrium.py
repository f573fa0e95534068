"""Find where an object comes to rest on the fingers that hold it, under an external force and torque.

The contacts are nonlinear springs in all six directions, up to the limit of friction. Newton's method finds the
object's pose: finite differences give the first stiffness, Broyden's rank-one updates maintain it (Nocedal and Wright,
Numerical Optimization, 2006, section 11.1). Beyond the limit of friction, there is no equilibrium and the object slips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.simulator.hand.held import Felt, Finger, Placement, felt
from tacshade_edge.simulator.hand.placed import Grip
from tacshade_edge.simulator.objects import Shape
from tacshade_edge.types import F64

_LENGTH_MM = 20.0  # a rotation by 1 rad counts as this length
_DIFFERENCE_MM = 0.05
_LONGEST_MM = 0.5  # of a step
_STEPS = 12
_TOLERANCE = 0.01  # of the sum of all normal loads and the external force


@dataclass(frozen=True, slots=True, eq=False)
class Wrench:
    """A force and a torque on an object, about its origin, over kn, in the hand's frame."""

    force_mm3: F64
    torque_mm4: F64


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """An object in equilibrium: its pose, the contact of each finger, and the unbalanced load."""

    hand_T_object: Rigid
    felts: tuple[Felt, ...]
    residual: Wrench


def borne(felts: Sequence[Felt], fingers: Sequence[Finger], hand_T_object: Rigid, mu: float) -> Wrench:
    """The wrench that the fingers exert on an object; `mu` is Coulomb's coefficient μ of all contacts."""
    force, torque = np.zeros(3), np.zeros(3)
    middle = hand_T_object.translation_mm
    for each, finger in zip(felts, fingers, strict=True):
        if (load := each.truth.load) is None:
            continue
        kt = mu / finger.sensor.model.coulomb  # over kn
        one = load.push_mm3 + kt * load.pull_mm3
        force += one
        torque += kt * load.torque_mm4 + np.cross(each.truth.hand_T_sensor.translation_mm - middle, one)
    return Wrench(force, torque)


def equilibrium(
    fingers: Sequence[Finger],
    body: Shape,
    start: Placement,
    grips: Sequence[Grip | None],
    outside: Wrench,
    mu: float,
) -> Rest | None:
    """Find the equilibrium near a placement, given each finger's grip, the load from outside and Coulomb's μ; None if
    friction cannot bear the load, or the object has left the fingers.
    """
    places = [start.hand_T_sensor(fingers, k) for k in range(len(fingers))]

    def at(x: F64) -> tuple[F64, Rest]:
        pose = start.hand_T_object @ turn(x[3:] / _LENGTH_MM)
        pose = shift(*x[:3].tolist()) @ pose
        felts = tuple(
            felt(finger, place, body, pose, grip) for finger, place, grip in zip(fingers, places, grips, strict=True)
        )
        inner = borne(felts, fingers, pose, mu)
        left = Wrench(inner.force_mm3 + outside.force_mm3, inner.torque_mm4 + outside.torque_mm4)
        return np.concatenate((left.force_mm3, left.torque_mm4 / _LENGTH_MM)), Rest(pose, felts, left)

    x = np.zeros(6)
    residual, rest = at(x)
    stiffness = np.stack([at(x + d)[0] - residual for d in _DIFFERENCE_MM * np.eye(6)], axis=1) / _DIFFERENCE_MM
    for _ in range(_STEPS):
        pressed_mm3 = sum(each.truth.load.normal_mm3 for each in rest.felts if each.truth.load)
        if np.linalg.norm(residual) <= _TOLERANCE * (pressed_mm3 + float(np.linalg.norm(outside.force_mm3))):
            return rest
        step = -np.linalg.lstsq(stiffness, residual, rcond=1e-6)[0]
        step *= min(1.0, _LONGEST_MM / max(float(np.linalg.norm(step)), 1e-12))
        before = residual
        x = x + step
        residual, rest = at(x)
        stiffness += np.outer(residual - before - stiffness @ step, step) / (step @ step)
    return None
