"""What is pressed: paths of objects on a skin,
each with stops at which the camera takes a picture.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tacshade_edge.lab.simulator.press import OBJECTS, PAPER_OBJECTS, Press
from tacshade_edge.types import F64

SurfaceZ = Callable[[float, float], float]
"""The z in mm of the untouched skin over x and y in mm."""

BALL_MM = 6.0
"""Radius of the simulator's ball, which is enlarged."""
BALLS_MM = (3.0, 4.5, 7.0)
SHALLOWEST_MM, DRAG_MM = 0.6, 2.0
STOPS = {"judged": 2, "touch": 1, "ball": 1}
"""Stops of a path of each kind; the second of a judged path is dragged."""
REACH = {"judged": 0.25, "touch": 0.38, "ball": 0.42}
"""Greatest distance from the tip, in skin radii."""
TOUCHING = ("bar", "cone", "cross", "edge", "plate", "prism", "ring", "two_balls", *PAPER_OBJECTS)
PLATE_MM = 1.0
"""Depth of a plate, which is wider than the skin."""


@dataclass(frozen=True, slots=True)
class PressPath:
    """An object that comes down along -z through stops, whose depths grow, and is dragged to the
    last one if that is dragged. `Press.depth_mm` is below the stated sphere.
    """

    object_name: str
    stops: tuple[Press, ...]
    depths_mm: tuple[float, ...]  # below the untouched skin, which a user states


@dataclass(frozen=True, slots=True)
class Dome:
    """What paths need of a skin: the radius that its user states, its surface,
    and the greatest depth on 20 mm.
    """

    radius_mm: float
    surface_z: SurfaceZ
    deepest_mm: float

    def below_sphere_mm(self, x_mm: float, y_mm: float, lowest_mm: float) -> float:
        """Compute `Press.depth_mm` from the z of the object's lowest point."""
        return math.sqrt(self.radius_mm**2 - x_mm**2 - y_mm**2) - lowest_mm


def paths(dome: Dome, kind: str, seed: int, count: int) -> list[PressPath]:
    """Draw the first paths of a kind of `STOPS`; judged ones take Table I's objects in turn."""
    rng = np.random.default_rng((seed, 50 + list(STOPS).index(kind)))
    names = rng.permutation(TOUCHING) if kind == "touch" else PAPER_OBJECTS
    made = []
    for k in range(count):
        name = "ball" if kind == "ball" else str(names[k % len(names)])
        rho = REACH[kind] * dome.radius_mm * math.sqrt(rng.random())
        at, turn, along = rng.uniform(0, 2 * math.pi, 3)
        enlarged = BALLS_MM[k % len(BALLS_MM)] / BALL_MM if kind == "ball" else 1.0
        cells = np.sort((rng.permutation(STOPS[kind]) + rng.random(STOPS[kind])) / STOPS[kind])
        depths = SHALLOWEST_MM + (dome.deepest_mm - SHALLOWEST_MM) * cells
        if kind == "judged":
            depths = np.full(2, dome.deepest_mm)
        if name == "plate":
            rho, depths = 0.0, PLATE_MM * cells
        scale = dome.radius_mm / 20
        first = Press(
            OBJECTS[name](),
            rho * math.cos(at),
            rho * math.sin(at),
            rotation_deg=math.degrees(turn),
            scale=scale * enlarged,
        )
        stops = [_deep(dome, first, float(depth) * scale) for depth in depths]
        stated = [float(depth) * scale for depth in depths]
        if kind == "judged":
            stops[1] = dragged(dome, stops[0], DRAG_MM * scale, along)
        made.append(PressPath(name, tuple(stops), tuple(stated)))
    return made


def _deep(dome: Dome, press: Press, depth_mm: float) -> Press:
    lowest = dome.surface_z(press.x_mm, press.y_mm) - depth_mm
    return replace(press, depth_mm=dome.below_sphere_mm(press.x_mm, press.y_mm, lowest))


def dragged(dome: Dome, press: Press, drag_mm: float, along: float) -> Press:
    """Drag a press in a direction, at the same height."""
    lowest = press.lowest_z_mm(dome.radius_mm)
    x_mm, y_mm = press.x_mm + drag_mm * math.cos(along), press.y_mm + drag_mm * math.sin(along)
    return replace(
        press,
        x_mm=x_mm,
        y_mm=y_mm,
        depth_mm=dome.below_sphere_mm(x_mm, y_mm, lowest),
        drag_x_mm=drag_mm * math.cos(along),
        drag_y_mm=drag_mm * math.sin(along),
    )


@dataclass(frozen=True, slots=True, eq=False)
class States:
    """The stored states of a path: points of the skin's outside (N, 3) untouched,
    and at each stop (S, N, 3), mm.
    """

    rest_mm: F64
    stops_mm: F64

    @classmethod
    def read(cls, path: Path) -> States:
        """Read a path's states. Raises FileNotFoundError."""
        with np.load(path) as file:
            return cls(file["rest_mm"], file["stops_mm"])

    def write(self, path: Path) -> None:
        """Write a path's states, completely or not at all."""
        part = path.with_suffix(".part.npz")
        np.savez_compressed(part, rest_mm=self.rest_mm, stops_mm=self.stops_mm.astype(np.float32))
        os.replace(part, path)


def states_file(folder: Path, range_name: str, number: int, kind: str, k: int) -> Path:
    """The file of a path's states."""
    return folder / f"{range_name}-{number}-{kind}-{k}.npz"
