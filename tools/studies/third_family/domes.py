"""Soft domes, drawn from two disjoint ranges, the paths of objects on them, and their frames.

A rubber skin lies on a gel, which is bonded to a stiff core, the window in front of the camera; the
rim is clamped. An object comes down along -z, then is dragged and turned, so a path has two states.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CloughTocher2DInterpolator

from tacshade_edge.calibration import indenters
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.lab.simulator.press import OBJECTS, Press, distance_mm
from tacshade_edge.lab.simulator.render import PinProfile, Renderer
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model
from tacshade_edge.lab.simulator.skin import Skin, direction_to_chart, undeformed
from tacshade_edge.lab.simulator.truth import Truth, measure, skin_points
from tacshade_edge.lab.studies.evaluate.work import PRESS_NOISE
from tacshade_edge.types import F64
from tools.studies.command import stated_press
from tools.testbed.simulator.families import lattice_print

RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "working": {
        "skin_mm": (1.0, 1.7),
        "gel_part": (0.25, 0.35),
        "stiffness_ratio": (2.0, 5.0),
        "poisson": (0.42, 0.45),
        "friction": (0.6, 0.8),
    },
    "final": {
        "skin_mm": (1.7, 2.4),
        "gel_part": (0.35, 0.45),
        "stiffness_ratio": (5.0, 8.0),
        "poisson": (0.45, 0.47),
        "friction": (0.8, 1.0),
    },
}
"""Ranges from which domes are drawn.

Nobody evaluates a network on ``final`` before all work on networks is done.
"""

FIRST_SEED = {"working": 31000, "final": 39100}
"""Seeds of the sensors' print, camera and light; no other family uses them."""


@dataclass(frozen=True, slots=True)
class Dome:
    """A skin on its gel."""

    radius_mm: float  # of the skin's outside, which touches and which the camera is assumed to see
    skin_mm: float  # thickness of the skin
    gel_part: float  # thickness of the gel below the skin, as a part of the radius
    # Young's modulus of the skin over that of the gel, which is 1: forces have no unit here.
    stiffness_ratio: float
    poisson: float  # of skin and gel
    friction: float  # Coulomb's coefficient


def drawn(range_name: str, number: int) -> tuple[SensorModel, Dome]:
    """Draw a sensor: its print and camera as for the training family, its dome from a range."""
    seed = FIRST_SEED[range_name] + number
    model = random_model(seed)
    rng = np.random.default_rng((seed, 41))
    values = {name: float(rng.uniform(*span)) for name, span in RANGES[range_name].items()}
    # The skin itself contains the material's motion (`deformed`),
    # so the renderer must not add friction.
    return replace(model, friction=0.0), Dome(radius_mm=model.skin_radius_mm, **values)


Solid = tuple[str, tuple[float, ...], tuple[float, float, float], tuple[float, float, float]]
"""A MuJoCo geom: kind, half sizes, middle and Euler angles,
in mm and degrees in the object's frame.
"""

ROUNDING_MM = 0.2
"""The skin's points carry balls of this radius, and solids are smaller by it,
so edges are as round as printed ones.
"""

DEEPEST_PART = 0.45
"""Depths are at most this part of the thickness of skin and gel, and 4 mm;
the material law allows no more.
"""

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
    """The path of one object on one dome; `press` is its end, after drag and twist."""

    object_name: str
    press: Press

    def pressed(self, skin_radius_mm: float) -> Press:
        """Return the press of the same object before drag and twist."""
        press = self.press
        x, y = press.x_mm - press.drag_x_mm, press.y_mm - press.drag_y_mm
        # The twist about the object's own axis is undone about z,
        # which is the same for an untilted object.
        lowest = press.lowest_z_mm(skin_radius_mm)
        depth = math.sqrt(skin_radius_mm**2 - x * x - y * y) - lowest
        return replace(
            press,
            x_mm=x,
            y_mm=y,
            depth_mm=depth,
            drag_x_mm=0.0,
            drag_y_mm=0.0,
            twist_deg=0.0,
            rotation_deg=press.rotation_deg - press.twist_deg,
        )


def plate_depth_mm(
    pressed_mm: float, radius_mm: float, scale: float, tilt_x_deg: float, tilt_y_deg: float
) -> float:
    """Compute `Press.depth_mm` (of the lowest edge) for a tilted plate over the tip,
    pressed along its normal.
    """
    upright = math.cos(math.radians(tilt_x_deg)) * math.cos(math.radians(tilt_y_deg))
    middle_mm = (radius_mm - pressed_mm) / upright
    return radius_mm - middle_mm + PLATE_MM * scale * math.sqrt(1 - upright * upright)


def deepest_mm(dome: Dome) -> float:
    """Compute the greatest depth of a path, in mm on a skin of 20 mm."""
    return min(
        4.0, DEEPEST_PART * (dome.skin_mm + dome.gel_part * dome.radius_mm) / (dome.radius_mm / 20)
    )


def ways(dome: Dome, seed: int, count: int) -> list[Way]:
    """Draw paths with object, place, depth, drag and twist;
    plates and every third path are tilted but not twisted.
    """
    radius_mm = dome.radius_mm
    rng = np.random.default_rng((seed, 42))
    names, scale, made = list(SOLIDS), radius_mm / 20, []
    deepest = deepest_mm(dome)
    first = int(rng.integers(len(names)))
    for k in range(count):
        name = names[(first + k) % len(names)]
        rho, angle, along, lean = rng.uniform((0, 0, 0, 0), (0.25 * radius_mm, *(2 * math.pi,) * 3))
        depth, drag, turn, twist, tilt = rng.uniform(
            (0.6, 0.0, 0, -10, 5), (deepest, 3.0, 360, 10, 20)
        )
        tilted = k % 3 == 2 or name == "plate"
        if name == "plate":
            lean_deg = tilt * math.cos(lean), tilt * math.sin(lean)
            rho, depth = (
                0.0,
                plate_depth_mm(0.6 * depth * scale, radius_mm, scale, *lean_deg) / scale,
            )
        made.append(
            Way(
                name,
                Press(
                    OBJECTS[name](),
                    rho * math.cos(angle),
                    rho * math.sin(angle),
                    depth * scale,
                    turn,
                    scale,
                    tilt * math.cos(lean) * tilted,
                    tilt * math.sin(lean) * tilted,
                    drag * scale * math.cos(along),
                    drag * scale * math.sin(along),
                    0.0 if tilted else twist,
                ),
            )
        )
    return made


SIZES_MM: dict[str, float] = {"ball": 6.0, "cylinder": 5.0, "cube": 10.0}
"""Radius of the ball and the cylinder, and side of the cube, of `SOLIDS`."""
KINDS = (
    ("ball", 3.0),
    ("cylinder", 2.5),
    ("ball", 4.5),
    ("cube", 6.0),
    ("ball", 7.0),
    ("cylinder", 4.0),
)
"""Object and its radius or side in mm on a skin of 20 mm; the presses take them in turn."""
SHALLOWEST_MM = 0.6
REACH_RADII = 0.4
"""Greatest distance of a press from the tip: beyond, the mesh is coarse."""


def known_ways(dome: Dome, seed: int, count: int) -> list[Way]:
    """Draw presses without drag, twist or tilt."""
    rng = np.random.default_rng((seed, 44))
    scale, made = dome.radius_mm / 20, []
    for k in range(count):
        name, size_mm = KINDS[k % len(KINDS)]
        rho, angle = (
            REACH_RADII * dome.radius_mm * math.sqrt(rng.random()),
            rng.uniform(0, 2 * math.pi),
        )
        depth_mm, turn_deg = rng.uniform((SHALLOWEST_MM, 0), (deepest_mm(dome), 360))
        x_mm, y_mm = rho * math.cos(angle), rho * math.sin(angle)
        enlarged = scale * size_mm / SIZES_MM[name]
        made.append(
            Way(name, Press(OBJECTS[name](), x_mm, y_mm, depth_mm * scale, turn_deg, enlarged))
        )
    return made


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """The stored states of a path: the skin's points (N, 3) without an object, pressed,
    and dragged.

    `penetration_mm` and `stirring_mm` (2,) are those of `solve.State`, pressed and dragged.
    """

    rest_mm: F64
    pressed_mm: F64
    dragged_mm: F64
    penetration_mm: F64
    stirring_mm: F64

    @classmethod
    def read(cls, path: Path) -> Kept:
        """Read a path's states. Raises FileNotFoundError."""
        with np.load(path) as file:
            return cls(**{name: file[name] for name in cls.__slots__})

    def write(self, path: Path) -> None:
        """Write a path's states, completely or not at all."""
        part = path.with_suffix(".part.npz")
        np.savez_compressed(part, **{name: getattr(self, name) for name in self.__slots__})
        os.replace(part, path)


def kept_file(folder: Path, range_name: str, sensor: int, what: str, number: int) -> Path:
    """The file of a path's states; `what` is empty or ``press``."""
    return folder / "-".join(filter(None, (range_name, str(sensor), what, f"{number}.npz")))


def known_presses(range_name: str, sensor: int, count: int, folder: Path) -> Sequence[KnownPress]:
    """Draw the stored presses of a sensor, with errors in the stated places and depths.

    Raises FileNotFoundError.
    """
    model, dome = drawn(range_name, sensor)
    seed = FIRST_SEED[range_name] + sensor
    draws, rng = renderer(model, seed), np.random.default_rng((seed, 45))
    made = []
    for k, way in enumerate(known_ways(dome, seed, count)):
        kept = Kept.read(kept_file(folder, range_name, sensor, "press", k))
        image = draws.expose(
            draws.draw(deformed(dome.radius_mm, kept.rest_mm, kept.pressed_mm)), PRESS_NOISE + k
        )
        size_mm = SIZES_MM[way.object_name] * way.press.scale
        shape = {
            "ball": None,
            "cube": indenters.box(f"square {size_mm:.1f}", size_mm, size_mm),
            "cylinder": indenters.cylinder(f"flat {2 * size_mm:.1f}", size_mm),
        }[way.object_name]
        made.append(
            stated_press(rng, f"press {k}", image, way.press, 0.0 if shape else size_mm, shape)
        )
    return made


TOUCHING_MM = 0.06
"""Skin nearer to the object than this counts as touching,
because it lies this far off between touching mesh points.
"""


def deformed(radius_mm: float, rest_mm: F64, at_mm: F64) -> Skin:
    """Make a smooth skin through mesh points (N, 3), given their places at rest and now.

    `Skin.origin_mm` contains the material's whole motion, so the model's `friction` must be 0.
    """
    flat = undeformed(radius_mm)
    n = len(flat.height_mm) // 2
    axis = np.arange(-n, n + 1) * flat.step_mm
    x, y = np.meshgrid(axis, axis)
    now, before = (
        np.stack(direction_to_chart(points, radius_mm), axis=-1) for points in (at_mm, rest_mm)
    )
    values = np.column_stack((radius_mm - np.linalg.norm(at_mm, axis=1), before - now))
    smooth = np.nan_to_num(CloughTocher2DInterpolator(now, values)(x, y)).astype(np.float32)
    return replace(
        flat,
        height_mm=smooth[..., 0],
        # No part of this skin leans, but a map of zeros allows contact where the skin has moved
        # outwards.
        leaning_mm=np.zeros_like(flat.height_mm),
        origin_mm=smooth[..., 1:],
    )


def seen_truth(skin: Skin, presses: Sequence[Press], model: SensorModel) -> Truth:
    """Measure the truth; skin inside an object also counts as touching,
    because MuJoCo's contact yields a little.
    """
    truth = measure(skin, presses, model.geometry, (model.image_height_px, model.image_width_px))
    rows, cols = np.nonzero(np.isfinite(truth.height_mm))
    points = skin_points(skin, model.geometry, rows.astype(float), cols.astype(float))
    touching = distance_mm(presses, skin.radius_mm, points) <= TOUCHING_MM
    contact = np.zeros_like(truth.contact)
    contact[rows[touching], cols[touching]] = True
    return replace(truth, contact=contact, points_mm=points[touching].astype(np.float32))


def renderer(model: SensorModel, seed: int) -> Renderer:
    """Draw a print: on the hexagonal or another lattice, with frusta, caps or pins with a waist."""
    rng = np.random.default_rng((seed, 43))
    marks = None if rng.random() < 0.5 else lattice_print(model, float(rng.uniform(60, 90)))
    kind = int(rng.integers(3))
    profile = (
        PinProfile(()),
        PinProfile(((1.0, 0.7, 0.0),)),
        PinProfile.waist(0.5, float(rng.uniform(0.7, 0.9))),
    )[kind]
    return Renderer(model, marks, profile)
