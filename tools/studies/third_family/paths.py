"""Paths of objects on a dome: an object comes down along -z, then is dragged and turned, so a path has two states."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tools.studies.third_family.dome import Dome

Solid = tuple[str, tuple[float, ...], tuple[float, float, float], tuple[float, float, float]]
"""A MuJoCo geom: kind, half sizes, middle and Euler angles, in mm and degrees in the object's frame."""

ROUNDING_MM = 0.2
"""The skin's points carry balls of this radius, and solids are smaller by it, so edges are as round as printed ones."""

DEEPEST_PART = 0.45
"""Depths are at most this part of the thickness of skin and gel, and 4 mm; the material law allows no more."""

PLATE_MM = 25.0
"""Radius of the plate."""

_BOX = 15.0 - ROUNDING_MM  # half the height of extruded solids
SOLIDS: dict[str, tuple[Solid, ...]] = {
    "ball": (("sphere", (5.8,), (0, 0, 6.0), (0, 0, 0)),),
    "cube": (("box", (4.8, 4.8, _BOX), (0, 0, 15), (0, 0, 0)),),
    "cylinder": (("cylinder", (4.8, _BOX), (0, 0, 15), (0, 0, 0)),),
    "plate": (("cylinder", (24.8, _BOX), (0, 0, 15), (0, 0, 0)),),
    "bar": (("capsule", (1.8, 7.0), (0, 0, 2.0), (0, 90, 0)),),
    "cross": (
        ("box", (6.8, 1.3, _BOX), (0, 0, 15), (0, 0, 0)),
        ("box", (1.3, 6.8, _BOX), (0, 0, 15), (0, 0, 0)),
    ),
    "two_balls": (
        ("sphere", (3.3,), (-5.0, 0, 3.5), (0, 0, 0)),
        ("sphere", (3.3,), (5.0, 0, 3.5), (0, 0, 0)),
    ),
}
"""The simulator's objects as MuJoCo solids, smaller by `ROUNDING_MM`."""


@dataclass(frozen=True, slots=True)
class Way:
    """The path of one object on one dome.

    Attributes
    ----------
    object_name : str
    press : Press
        The end of the path, after drag and twist.
    """

    object_name: str
    press: Press

    def pressed(self, skin_radius_mm: float) -> Press:
        """Return the press of the same object before drag and twist."""
        press = self.press
        x, y = press.x_mm - press.drag_x_mm, press.y_mm - press.drag_y_mm
        # The twist about the object's own axis is undone about z, which is the same for an untilted object.
        lowest = press.lowest_z_mm(skin_radius_mm)
        depth = math.sqrt(skin_radius_mm**2 - x * x - y * y) - lowest
        return replace(
            press, x_mm=x, y_mm=y, depth_mm=depth, drag_x_mm=0.0, drag_y_mm=0.0, twist_deg=0.0,
            rotation_deg=press.rotation_deg - press.twist_deg,
        )  # fmt: skip


def plate_depth_mm(pressed_mm: float, radius_mm: float, scale: float, tilt_x_deg: float, tilt_y_deg: float) -> float:
    """Compute `Press.depth_mm` (of the lowest edge) for a tilted plate over the tip, pressed along its normal."""
    upright = math.cos(math.radians(tilt_x_deg)) * math.cos(math.radians(tilt_y_deg))
    middle_mm = (radius_mm - pressed_mm) / upright
    return radius_mm - middle_mm + PLATE_MM * scale * math.sqrt(1 - upright * upright)


def deepest_mm(dome: Dome) -> float:
    """Compute the greatest depth of a path, in mm on a skin of 20 mm."""
    return min(4.0, DEEPEST_PART * (dome.skin_mm + dome.gel_part * dome.radius_mm) / (dome.radius_mm / 20))


def ways(dome: Dome, seed: int, count: int) -> list[Way]:
    """Draw paths with object, place, depth, drag and twist; plates and every third path are tilted but not twisted."""
    radius_mm = dome.radius_mm
    rng = np.random.default_rng((seed, 42))
    names, scale, made = list(SOLIDS), radius_mm / 20, []
    deepest = deepest_mm(dome)
    first = int(rng.integers(len(names)))
    for k in range(count):
        name = names[(first + k) % len(names)]
        rho, angle, along, lean = rng.uniform((0, 0, 0, 0), (0.25 * radius_mm, *(2 * math.pi,) * 3))
        depth, drag, turn, twist, tilt = rng.uniform((0.6, 0.0, 0, -10, 5), (deepest, 3.0, 360, 10, 20))
        tilted = k % 3 == 2 or name == "plate"
        if name == "plate":
            lean_deg = tilt * math.cos(lean), tilt * math.sin(lean)
            rho, depth = 0.0, plate_depth_mm(0.6 * depth * scale, radius_mm, scale, *lean_deg) / scale
        made.append(
            Way(name, Press(
                OBJECTS[name](), rho * math.cos(angle), rho * math.sin(angle), depth * scale, turn, scale,
                tilt * math.cos(lean) * tilted, tilt * math.sin(lean) * tilted,
                drag * scale * math.cos(along), drag * scale * math.sin(along), 0.0 if tilted else twist,
            ))
        )  # fmt: skip
    return made
