"""Frames of a hand that holds an object, with the truth, for studies of the object's motion and of the grip."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.simulator.hand import Finger, FingerSensor, HandScript, HandTruth, hold
from tacshade_edge.simulator.press import Shape
from tacshade_edge.simulator.skin import Skin
from tacshade_edge.types import F64, U8

STEP_S = 1 / 60
"""The simulation follows an object's path in steps of at most this time, however few frames are taken."""


class DrawnSensor(FingerSensor, Protocol):
    """A simulated sensor that takes pictures."""

    def picture(self, skin: Skin, noise_seed: int = 0) -> U8:
        """Take a picture of a skin."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class HandFrame:
    """Pictures of all fingers (BGR), taken at the same time."""

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
    """Take pictures from the first knot of a script to its last. The same seed of the noise gives the same frames.

    Each finger has a sensor of its own, so that each draws a resting skin only once. Up to 60 fps, the steps are
    `STEP_S` or shorter; above, there is one step per frame.
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
    """Compute ``hand_T_sensor`` of a finger that faces along a direction, with its undeformed apex past a point.

    Its x axis is at right angles to this direction and as close as possible to the hand's x axis, or to the hand's y
    axis if the direction is almost along x.
    """
    z = along / np.linalg.norm(along)
    x = np.eye(3)[0 if abs(z[0]) < 0.9 else 1]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    rotation = np.stack((x, np.cross(z, x), z), axis=1)
    return Rigid(rotation, point_mm + (apex_mm - skin_radius_mm) * z)


def about(pose: Rigid, translation_mm: F64, rotation_rad: F64) -> Rigid:
    """Turn an object's pose about its own origin, then move it, both along the hand's axes."""
    turned = turn(rotation_rad).rotation @ pose.rotation
    return shift(*translation_mm.tolist()) @ Rigid(turned, pose.translation_mm)
