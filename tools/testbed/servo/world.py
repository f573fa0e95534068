"""A surface and an edge with the true touch at each pose of the sensor, and a robot that lags."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from tacshade_edge.lab.simulator.skin import Skin
from tacshade_edge.rigid import Rigid, from_seven, shift, turn
from tacshade_edge.types import F64
from tools.testbed.servo.skins import MODEL, EdgeSkins, PlaneSkins

WAVE_MM: Final = 80.0
SWELL_MM: Final = 2.0
SIDEWAYS: Final = 0.1
"""Steepest slope of the surface across the path."""
LAG_S: Final = 0.03
"""Time constant of the robot's velocity."""
_STEP_S = 0.002
_K = 2 * math.pi / WAVE_MM
_DOWN = from_seven((0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0))


class Scene(Protocol):
    """The object under the sensor; poses are ``base_T_sensor``."""

    start: Rigid

    def touch(self, pose: Rigid) -> dict[str, float]:
        """Compute the true touch, with the names of LABELS.csv."""
        ...

    def skin(self, touch: Mapping[str, float]) -> Skin:
        """Make the skin under a touch."""
        ...


class Surface:
    """A surface with waves 4 mm high and 80 mm long, up to 9° steep along x and 6° across,
    drawn as a tangent plane.
    """

    start = shift(0, 0, MODEL.skin_radius_mm - 1.0) @ _DOWN

    def __init__(self, skins: PlaneSkins) -> None:
        self._skins = skins

    def touch(self, pose: Rigid) -> dict[str, float]:
        """Compute the depth along the normal at the nearest point, and the tilt of that normal."""
        x0, y0, z0 = pose.translation_mm.tolist()
        x, y, z = x0, y0, 0.0
        for _ in range(
            12
        ):  # this converges, because the surface's radii of curvature are over 80 mm
            z = SWELL_MM * (1 - math.cos(_K * x)) + SIDEWAYS * y * math.sin(_K * x / 2)
            along = SWELL_MM * _K * math.sin(_K * x) + SIDEWAYS * y * _K / 2 * math.cos(_K * x / 2)
            across = SIDEWAYS * math.sin(_K * x / 2)
            x, y = x0 + along * (z0 - z), y0 + across * (z0 - z)
        to_place = pose.rotation.T @ np.array((x - x0, y - y0, z - z0))
        distance = float(np.linalg.norm(to_place))
        n_x, n_y, n_z = (to_place / distance).tolist()
        return {
            "depth_mm": MODEL.skin_radius_mm - distance,
            "tilt_x_deg": -math.degrees(math.asin(n_y)),
            "tilt_y_deg": math.degrees(math.atan2(n_x, n_z)),
        }

    def skin(self, touch: Mapping[str, float]) -> Skin:
        """Make the skin under the surface's tangent plane."""
        b, c = math.radians(touch["tilt_x_deg"]), math.radians(touch["tilt_y_deg"])
        normal = np.array((math.cos(b) * math.sin(c), -math.sin(b), math.cos(b) * math.cos(c)))
        return self._skins.skin(touch["depth_mm"], normal)


class Edge:
    """A flat plate at right angles to the sensor; its edge has waves 4 mm high
    and 80 mm long but is drawn straight.
    """

    start = shift(0, 0, MODEL.skin_radius_mm - 1.0) @ _DOWN

    def __init__(self, skins: EdgeSkins) -> None:
        self._skins = skins

    def touch(self, pose: Rigid) -> dict[str, float]:
        """Compute the tip's depth below the plate's top, the edge's place on the sensor's y axis,
        and its direction.
        """
        x0, y0, z0 = pose.translation_mm.tolist()
        x = x0
        for _ in range(12):
            y, slope = SWELL_MM * (1 - math.cos(_K * x)), SWELL_MM * _K * math.sin(_K * x)
            x = x0 + slope * (y0 - y)
        foot = pose.rotation.T @ np.array((x - x0, y - y0, 0.0))
        along = pose.rotation.T @ np.array((1.0, slope, 0.0))
        angle = math.atan2(along[1], along[0])
        offset_mm = float(foot[1] * math.cos(angle) - foot[0] * math.sin(angle))
        return {
            "depth_mm": MODEL.skin_radius_mm - z0,
            "y_mm": offset_mm / math.cos(angle),
            "edge_deg": math.degrees(angle),
        }

    def skin(self, touch: Mapping[str, float]) -> Skin:
        """Make the skin under the edge's tangent."""
        angle_deg = touch["edge_deg"]
        offset_mm = touch["y_mm"] * math.cos(math.radians(angle_deg))
        return self._skins.skin(touch["depth_mm"], offset_mm, angle_deg)


def scene(name: str, kept: Path) -> Scene:
    """Make the scene `surface` or `edge`; `kept` is the folder of tables."""
    return Surface(PlaneSkins()) if name == "surface" else Edge(EdgeSkins(kept / "edge_skins.npy"))


class LateRobot:
    """Obeys commands `delay_s` after they arrive, with a velocity that follows
    with the time constant `LAG_S`.

    `pose` is ``base_T_sensor`` at `now_s`.
    """

    def __init__(self, pose: Rigid, delay_s: float, now_s: float) -> None:
        self.pose = pose
        self._delay_s, self._now_s = delay_s, now_s
        self._waiting: deque[tuple[float, F64]] = deque()
        self._asked = self._velocity = np.zeros(6)

    def hear(self, at_s: float, velocity: F64) -> None:
        """Take a command: the tip's velocity (6,) in mm/s and °/s,
        along and about the sensor's axes.
        """
        self._waiting.append((at_s + self._delay_s, velocity))

    def go_on(self, until_s: float) -> None:
        """Move until a time in s."""
        while self._now_s + _STEP_S <= until_s:
            while self._waiting and self._waiting[0][0] <= self._now_s:
                self._asked = self._waiting.popleft()[1]
            self._velocity = self._velocity + (_STEP_S / LAG_S) * (self._asked - self._velocity)
            moved = shift(*(_STEP_S * self._velocity[:3]).tolist())
            turned = turn(np.radians(_STEP_S * self._velocity[3:]))
            tip_mm = MODEL.skin_radius_mm
            self.pose = self.pose @ shift(0, 0, tip_mm) @ moved @ turned @ shift(0, 0, -tip_mm)
            self._now_s += _STEP_S
