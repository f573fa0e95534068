"""Convert an object's pose to the `Press` on one finger.

The shape of that press is the object as it lies, which makes its position exact. A press states how the object moved
since it touched as a drag and a twist: those of the material at the middle of the contact. A rotation about an axis
along the skin would also move the rest of the contact, by at most the sine of its angle times the variation of the
contact's height (0.6 mm over a contact of 10 mm: 0.05 mm for 5°). This is neglected.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.rigid import Rigid
from tacshade_edge.simulator.model import RIM_HALF_ANGLE_DEG
from tacshade_edge.simulator.objects import Shape
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.skin import node_directions
from tacshade_edge.types import F64

_EVERY = 4  # step of the sampled nodes in the skin's grid
_STEPS = 40
_NEAREST = 0.3  # of the skin's radius


@dataclass(frozen=True, slots=True, eq=False)
class Grip:
    """The memory of a finger's contact: the object's pose when it touched, and how far it has slid over the skin since,
    along x and y in mm and about z in degrees.
    """

    sensor_T_object: Rigid
    slid: tuple[float, float, float] = (0.0, 0.0, 0.0)


def contact_centre(body: Shape, sensor_T_object: Rigid, skin_radius_mm: float) -> F64 | None:
    """The centre (3,) of the object's surface inside the undeformed skin, in the sensor frame; None without contact,
    that is, with less than a millimetre of skin.
    """
    directions = _looked_at(skin_radius_mm)
    object_T_sensor = sensor_T_object.inverse()
    inside = np.maximum(-body.sdf(object_T_sensor.apply(directions * skin_radius_mm)), 0)
    if not inside.any():
        return None
    middle = inside @ directions
    middle /= np.linalg.norm(middle)
    t = skin_radius_mm
    for _ in range(_STEPS):
        t += float(body.sdf(object_T_sensor.apply(t * middle[None]))[0])
        t = min(max(t, _NEAREST * skin_radius_mm), skin_radius_mm)
    return np.asarray(t * middle)


def moved_along(grip: Grip, now: Rigid, at_mm: F64) -> tuple[float, float, float]:
    """Drag along x and y in mm, and twist in degrees, of the material now at a point (3,)."""
    back = grip.sensor_T_object @ now.inverse()
    x_mm, y_mm = (at_mm - back.apply(at_mm))[:2].tolist()
    (a, b), (c, d) = back.rotation[:2, :2]
    x, y, turned = grip.slid
    return x_mm - x, y_mm - y, math.degrees(math.atan2(b - c, a + d)) - turned


def slid_on(grip: Grip, drag: tuple[float, float, float], surplus: float) -> Grip:
    """The grip after the object slid by a part of its drag; an object that turns back then loads it at once."""
    if not surplus:
        return grip
    x, y, turned = (of + surplus * by for of, by in zip(grip.slid, drag, strict=True))
    return replace(grip, slid=(x, y, turned))


def press_of(body: Shape, now: Rigid, skin_radius_mm: float, at_mm: F64, drag: tuple[float, float, float]) -> Press:
    """The object as it lies, as a press of depth 0 at a point (3,) of its contact, with a drag and a twist; the origin
    of such a press lies on the undeformed skin.
    """
    x, y, _ = at_mm.tolist()
    origin = np.array((x, y, math.sqrt(skin_radius_mm**2 - x * x - y * y)))
    object_T_press = now.inverse() @ Rigid(np.eye(3), origin)
    turn, place = object_T_press.rotation.T, object_T_press.translation_mm

    def sdf(points: F64) -> F64:
        return body.sdf(points @ turn.astype(points.dtype) + place.astype(points.dtype))

    along_x, along_y, twist = drag
    return Press(Shape(body.name, sdf), x, y, 0.0, drag_x_mm=along_x, drag_y_mm=along_y, twist_deg=twist)


@functools.lru_cache(maxsize=8)
def _looked_at(skin_radius_mm: float) -> F64:
    """Unit vectors (N, 3) of the skin inside its rim."""
    every = node_directions(skin_radius_mm)[::_EVERY, ::_EVERY].reshape(-1, 3)
    return every[every[:, 2] > math.cos(math.radians(RIM_HALF_ANGLE_DEG))].astype(np.float64)
