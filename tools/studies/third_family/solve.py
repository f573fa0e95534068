"""The mechanics: solve the missing paths of a range's sensors, which is slow,
and store a file for each.

::

    nice PYTHON -m tools.studies.third_family.solve --states FOLDER [--range working] [--sensors 6]
        [--ways 6]
        [--presses 40]

PYTHON must have MuJoCo (requirements.txt). The object is a heavy body with a prescribed velocity.
Every point of the skin's outside carries a small ball that can touch the object, so contact is
between points and a rigid surface and follows Coulomb's law. A step of MuJoCo's `discrete`
integrator is one Newton step of the static problem, with implicit elasticity and contact; steps are
so long that inertia plays no role. Skin and gel are layers of tetrahedra over one triangulation of
the sphere, fine at the tip and coarse at the rim.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial import Delaunay

from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.lab.simulator.sensor_model import RIM_HALF_ANGLE_DEG
from tacshade_edge.types import F64, I64, Bool
from tools.studies.third_family.domes import (
    FIRST_SEED,
    RANGES,
    ROUNDING_MM,
    Dome,
    Kept,
    Way,
    drawn,
    kept_file,
    known_ways,
    ways,
)
from tools.studies.third_family.judging import BALL, DRAGGED, ball_ways, dragged_ways
from tools.studies.third_family.table_i import TABLE_I_SOLIDS, WHAT, table_i_ways

EDGE_MM = 1.3
"""Edge length of the mesh at the tip, on a skin of 20 mm."""
APPROACH_MM, DRAG_MM, TWIST_DEG, SETTLING = 0.35, 0.2, 1.5, 12
"""Greatest motions in one step, and the number of steps in which the object then rests."""

_DENSITY = (
    5e-3  # m / dt²; contact is 10,000 times as stiff, so this makes it stiff compared with the gel
)
_DAMPING = 3.0
FINE_DEG = 26.0
"""Up to this angle from the tip, the mesh has its shortest edges;
beyond, they grow towards the rim.
"""

COARSER = 3.0
"""Edges at the rim are longer by this multiple of the edges at the tip."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Tetrahedra of a dome at rest."""

    points_mm: F64  # (N, 3) in the sensor frame; the first `surface` ones are the skin's outside
    surface: int
    skin: I64  # (M, 4) corners of the tetrahedra, right-handed
    gel: I64
    clamped: Bool  # (N,) at the rim or on the core


def meshed(dome: Dome, edge_mm: float, gel_layers: int = 3) -> Mesh:
    """Fill a dome with tetrahedra whose edges at the tip have about the given length."""
    direction, triangles = cap(dome.radius_mm, edge_mm)
    count = len(direction)
    depths = (
        np.linspace(0, 1, gel_layers + 1) ** 1.15 * dome.gel_part * dome.radius_mm + dome.skin_mm
    )
    radii = dome.radius_mm - np.concatenate(((0.0,), depths))
    points = np.concatenate([direction * radius for radius in radii])
    rim = direction[:, 2] < math.cos(math.radians(RIM_HALF_ANGLE_DEG)) + 1e-9
    clamped = np.tile(rim, len(radii))
    clamped[-count:] = True
    layers = [_righted(points, _layer(triangles, count, k)) for k in range(len(radii) - 1)]
    return Mesh(points, count, layers[0], np.concatenate(layers[1:]), clamped)


def cap(radius_mm: float, edge_mm: float) -> tuple[F64, I64]:
    """Make unit vectors (N, 3) in rings from the tip to the rim, and triangles (M,
    3) between them.
    """
    rim = math.radians(RIM_HALF_ANGLE_DEG)
    fine = math.radians(FINE_DEG)
    points, angle, ring = [(0.0, 0.0, 1.0)], 0.0, 0
    while angle < rim:
        edge = edge_mm * (1 + COARSER * max(0.0, (angle - fine) / (rim - fine)))
        angle += 0.87 * edge / radius_mm
        if angle > rim - 0.4 * edge / radius_mm:
            angle = rim
        ring += 1
        count = max(6, round(2 * math.pi * math.sin(angle) * radius_mm / edge))
        around = 2 * math.pi * np.arange(count) / count + 0.5 * ring
        points += [
            (math.sin(angle) * math.cos(a), math.sin(angle) * math.sin(a), math.cos(angle))
            for a in around
        ]
    direction = np.array(points)
    return direction, Delaunay(direction[:, :2] / (1 + direction[:, 2:])).simplices.astype(np.int64)


def volumes(points_mm: F64, corners: I64) -> F64:
    """Compute the signed volumes (M,) of tetrahedra in mm³."""
    p = points_mm[corners]
    a, b, c = (p[:, k] - p[:, 0] for k in (1, 2, 3))
    return np.asarray(np.einsum("ij,ij->i", np.cross(a, b), c) / 6)


def _layer(triangles: I64, count: int, outer: int) -> I64:
    """Cut the prisms between two layers into tetrahedra;
    sorted corners make the cuts of neighbours agree.
    """
    a, b, c = (np.sort(triangles, axis=1) + outer * count).T
    below = count
    return np.concatenate(
        [
            np.stack(corners, axis=1)
            for corners in (
                (a, b, c, c + below),
                (a, b, b + below, c + below),
                (a, a + below, b + below, c + below),
            )
        ]
    )


def _righted(points: F64, corners: I64) -> I64:
    left = volumes(points, corners) < 0
    corners = corners.copy()
    corners[left] = corners[left][:, (1, 0, 2, 3)]
    return corners


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """The skin's outside (N, 3) under an object.

    `penetration_mm` is how deep its deepest point lies inside the object, `stirring_mm` the
    greatest motion in the last step of rest.
    """

    at_mm: F64
    penetration_mm: float
    stirring_mm: float


def solved(dome: Dome, way: Way) -> Kept:
    """Press and drag an object. Raises RuntimeError (MuJoCo warned of a bad state)."""
    mujoco.set_mju_user_warning(
        lambda _: None
    )  # MuJoCo would write a file here; `_moved` checks its counts
    mesh = meshed(dome, EDGE_MM * dome.radius_mm / 20)
    model = mujoco.MjModel.from_xml_string(_xml(dome, mesh, way))
    data = mujoco.MjData(model)
    press = way.press
    end = np.array((press.x_mm, press.y_mm, press.origin_z_mm(dome.radius_mm), 0.0))
    touch = end - (press.drag_x_mm, press.drag_y_mm, 0.0, math.radians(press.twist_deg))
    travel = _clearance_mm(dome, way)
    data.qpos[:4] = touch
    data.qpos[2] += travel
    steps = max(4, math.ceil(travel / APPROACH_MM))
    pressed = _moved(model, data, touch, steps, mesh)
    steps = math.ceil(
        max(
            math.hypot(press.drag_x_mm, press.drag_y_mm) / DRAG_MM, abs(press.twist_deg) / TWIST_DEG
        )
    )
    dragged = _moved(model, data, end, steps, mesh) if steps else pressed
    return Kept(
        mesh.points_mm[: mesh.surface],
        pressed.at_mm,
        dragged.at_mm,
        np.array((pressed.penetration_mm, dragged.penetration_mm)),
        np.array((pressed.stirring_mm, dragged.stirring_mm)),
    )


def _moved(model: mujoco.MjModel, data: mujoco.MjData, to: F64, steps: int, mesh: Mesh) -> State:
    start, before = data.qpos[:4].copy(), data.qpos.copy()
    for k in range(steps + SETTLING):
        goal = start + (to - start) * min(1.0, (k + 1) / steps)
        data.qvel[:4] = (goal - data.qpos[:4]) / model.opt.timestep
        before = data.qpos.copy()
        mujoco.mj_step(model, data)
        data.qpos[:4] = goal
    # MuJoCo softens and counts stiffnesses that compression makes singular;
    # any other warning is an error.
    softened = int(mujoco.mjtWarning.mjWARN_INERTIA)
    if any(warning.number for kind, warning in enumerate(data.warning) if kind != softened):
        raise RuntimeError(f"the engine warned at {data.qpos[:4]}")
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    deepest = min((float(contact.dist) for contact in data.contact), default=0.0)
    at = data.xpos[2 : 2 + mesh.surface].copy()
    return State(at, max(-deepest, 0.0), float(np.abs(data.qpos - before)[4:].max()))


def _clearance_mm(dome: Dome, way: Way) -> float:
    """Find how far above its pressed place an object just leaves the undeformed skin."""
    press, radius = way.pressed(dome.radius_mm), dome.radius_mm
    angle, around = np.meshgrid(
        np.linspace(0, math.radians(70), 120), np.linspace(0, 2 * math.pi, 120)
    )
    skin = radius * np.stack(
        (np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)), axis=-1
    ).reshape(-1, 3)
    low, high = 0.0, radius
    for _ in range(20):
        middle = (low + high) / 2
        free = float(press.distance_mm(radius, skin - (0, 0, middle)).min()) > 0
        low, high = (low, middle) if free else (middle, high)
    return high


def _xml(dome: Dome, mesh: Mesh, way: Way) -> str:
    weight = np.zeros(len(mesh.points_mm))
    for corners in (mesh.skin, mesh.gel):
        np.add.at(weight, corners, (_DENSITY * volumes(mesh.points_mm, corners) / 4)[:, None])
    ball = ROUNDING_MM * way.press.scale
    touching = (
        f'<geom type="sphere" size="{ball:.6g}" mass="0" contype="2" conaffinity="1" '
        f'friction="{dome.friction} 0 0" solref="-1e9 -1e7" solimp="0.9999 0.9999 0.001"/>'
    )
    sliding = "".join(
        f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1")
    )
    bodies = []
    for k, (point, mass, clamped) in enumerate(
        zip(mesh.points_mm, weight, mesh.clamped, strict=True)
    ):
        free = (
            f'<inertial pos="0 0 0" mass="{mass:.9g}" diaginertia="{mass:.9g} {mass:.9g} '
            f'{mass:.9g}"/>{sliding}'
        )
        inside = ("" if clamped else free) + (touching if k < mesh.surface else "")
        bodies.append(f'<body name="p{k}" pos="{_text(point)}">{inside}</body>')
    return (
        '<mujoco><option timestep="1" gravity="0 0 0" integrator="discrete" '
        'solver="Newton" cone="elliptic" '
        'impratio="10" iterations="100" tolerance="1e-10">'
        '<flag refsafe="disable"/></option><size memory="2G"/>'
        '<worldbody><body name="object">'
        f'<inertial pos="0 0 0" mass="1e6" diaginertia="1e8 1e8 1e8"/>{sliding}'
        f'<joint type="hinge" axis="0 0 1"/>{_solids(way)}</body>'
        f"{''.join(bodies)}</worldbody><deformable>"
        f"{_flex('skin', mesh.skin, dome.stiffness_ratio, dome.poisson)}"
        f"{_flex('gel', mesh.gel, 1.0, dome.poisson)}</deformable></mujoco>"
    )


def _solids(way: Way) -> str:
    press, made = way.press, []
    a = math.radians(press.rotation_deg)
    turn = np.array(((math.cos(a), -math.sin(a), 0), (math.sin(a), math.cos(a), 0), (0, 0, 1)))
    # The object's orientation at the end of the path, where the hinge is at 0.
    own = Press(press.shape, tilt_x_deg=press.tilt_x_deg, tilt_y_deg=press.tilt_y_deg).tilt() @ turn
    for kind, sizes, middle, (about_x, about_y, _) in TABLE_I_SOLIDS[way.object_name]:
        lying = Press(press.shape, tilt_x_deg=about_x, tilt_y_deg=about_y).tilt()
        axes = own @ lying
        made.append(
            f'<geom type="{kind}" size="{_text(np.array(sizes) * press.scale)}" '
            f'pos="{_text(own @ middle * press.scale)}" mass="0" contype="1" conaffinity="2" '
            f'friction="1e-3 0 0" xyaxes="{_text(axes[:, 0])} {_text(axes[:, 1])}"/>'
        )
    return "".join(made)


def _flex(name: str, corners: np.typing.NDArray[np.int64], young: float, poisson: float) -> str:
    used, own = np.unique(corners, return_inverse=True)
    return (
        f'<flex name="{name}" dim="3" radius="0" body="{" ".join(f"p{k}" for k in used)}" '
        f'element="{" ".join(map(str, own.ravel()))}">'
        f'<elasticity young="{young}" poisson="{poisson}" damping="{_DAMPING}"/>'
        '<contact contype="0" conaffinity="0" selfcollide="none"/></flex>'
    )


def _text(numbers: F64) -> str:
    return " ".join(f"{number:.9g}" for number in numbers)


def jobs(options: argparse.Namespace) -> Iterator[tuple[Path, Dome, Way]]:
    """The paths that are wanted, and where each is kept."""
    for sensor in range(options.sensors):
        _, dome = drawn(options.range, sensor)
        seed = FIRST_SEED[options.range] + sensor
        wanted = {
            DRAGGED: dragged_ways(dome, seed) if options.dragged else [],
            "": ways(dome, seed, options.ways),
            "press": known_ways(dome, seed, options.presses),
            WHAT: table_i_ways(dome) if options.table_i else [],
            BALL: ball_ways(dome, seed, options.balls),
        }
        for what, paths in wanted.items():
            for k, way in enumerate(paths):
                yield kept_file(options.states, options.range, sensor, what, k), dome, way


def main(arguments: list[str] | None = None) -> int:
    """Solve the missing paths of a range."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--range", choices=RANGES, default="working")
    parser.add_argument("--sensors", type=int, default=6)
    parser.add_argument(
        "--ways", type=int, default=6, help="objects on each sensor, two states each"
    )
    parser.add_argument(
        "--presses", type=int, default=0, help="that each sensor is calibrated on (none)"
    )
    parser.add_argument(
        "--states", type=Path, required=True, help="existing files stay as they are"
    )
    parser.add_argument(
        "--table-i", action="store_true", help="Table I's objects as well (tools.studies.paper)"
    )
    parser.add_argument(
        "--dragged",
        action="store_true",
        help="Table I's objects, dragged (tools.studies.strangers)",
    )
    parser.add_argument("--balls", type=int, default=0, help="of those presses (none)")
    options = parser.parse_args(arguments)
    options.states.mkdir(parents=True, exist_ok=True)
    for path, dome, way in jobs(options):
        if not path.exists():
            solved(dome, way).write(path)
            print(f"{path.name}: {way.object_name}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
