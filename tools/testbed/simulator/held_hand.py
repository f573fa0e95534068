"""Frames of a hand that holds an object, with all truths: for studies of its motion and of how firmly it is held."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.simulator.hand.held import Finger, FingerSensor, HandTruth, hold
from tacshade_edge.simulator.hand.script import HandScript
from tacshade_edge.simulator.objects import Shape
from tacshade_edge.simulator.skin import Skin
from tacshade_edge.types import F64, U8

STEP_S = 1 / 60
"""An object's way is followed in steps of this, however few frames are taken."""


class DrawnSensor(FingerSensor, Protocol):
    """A simulated sensor that takes pictures."""

    def picture(self, skin: Skin, noise_seed: int = 0) -> U8:
        """Take a picture of a skin."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class HandFrame:
    """A picture of every finger, taken at once.

    Attributes
    ----------
    t_s : float
    images : tuple of uint8 (H, W, 3)
        Of each finger, BGR.
    skins : tuple of Skin
    truth : HandTruth
    """

    t_s: float
    images: tuple[U8, ...]
    skins: tuple[Skin, ...]
    truth: HandTruth


def hand_frames(
    sensors: Sequence[DrawnSensor],
    hand_T_sensors: Sequence[Rigid],
    body: Shape,
    script: HandScript,
    fps: float,
    seed: int = 0,
    names: Sequence[str] = ("thumb", "index", "middle", "ring", "little"),
) -> Iterator[HandFrame]:
    """Take pictures from the first knot of a script to its last. The same seed gives the same frames.

    Parameters
    ----------
    sensors : sequence of DrawnSensor
        One of its own for each finger: what rests is drawn once.
    hand_T_sensors : sequence of Rigid
        Where each of them holds.
    body : Shape
        `simulator.hand.bodies`, or `mesh_shape`.
    script : HandScript
    fps : float
        1 to 60 are followed in steps of `STEP_S` or less; above that, of a frame each.
    seed : int
        Of the noise.
    names : sequence of str
        As many as sensors, or more.
    """
    fingers = [Finger(*each) for each in zip(names, hand_T_sensors, sensors, strict=False)]
    steps = max(1, math.ceil(1 / (fps * STEP_S) - 1e-9))
    begin_s, end_s = script.times_s[0], script.times_s[-1]
    times_s = [begin_s + k / (fps * steps) for k in range(math.floor((end_s - begin_s) * fps + 1e-9) * steps + 1)]
    for k, (truth, skins) in enumerate(hold(fingers, body, [script.at(t) for t in times_s])):
        if k % steps == 0:
            frame = k // steps
            images = tuple(
                sensor.picture(skin, noise_seed=seed + 1_000_003 * frame + finger)
                for finger, (sensor, skin) in enumerate(zip(sensors, skins, strict=True))
            )
            yield HandFrame(times_s[k], images, tuple(skins), truth)


def looking_at(point_mm: F64, along: F64, apex_mm: float, skin_radius_mm: float) -> Rigid:
    """``hand_T_sensor`` of a finger whose undeformed apex is so far past a point, along a direction that it looks in.

    Its x lies across that direction and as near to the hand's x as can be; where that is none, to the hand's y.
    """
    z = along / np.linalg.norm(along)
    x = np.eye(3)[0 if abs(z[0]) < 0.9 else 1]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    rotation = np.stack((x, np.cross(z, x), z), axis=1)
    return Rigid(rotation, point_mm + (apex_mm - skin_radius_mm) * z)


def about(pose: Rigid, translation_mm: F64, rotation_rad: F64) -> Rigid:
    """An object's pose after a turn about its own origin, and a move, both along the hand's axes."""
    turned = turn(rotation_rad).rotation @ pose.rotation
    return shift(*translation_mm.tolist()) @ Rigid(turned, pose.translation_mm)
