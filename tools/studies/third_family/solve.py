"""The mechanics: MuJoCo's tetrahedra under a rigid object with friction, in steps so long that inertia plays no role.

The object is a heavy body with a prescribed velocity. Every point of the skin's outside carries a small ball that can
touch the object, so contact is between points and a rigid surface and follows Coulomb's law. A step of MuJoCo's
`discrete` integrator is one Newton step of the static problem, with implicit elasticity and contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from tacshade_edge.simulator.press import Press
from tacshade_edge.types import F64
from tools.studies.third_family.dome import Dome, Mesh, meshed, volumes
from tools.studies.third_family.paths import ROUNDING_MM, SOLIDS, Way

EDGE_MM = 1.3
"""Edge length of the mesh at the tip, on a skin of 20 mm."""
APPROACH_MM, DRAG_MM, TWIST_DEG, SETTLING = 0.35, 0.2, 1.5, 12
"""Greatest motions in one step, and the number of steps in which the object then rests."""

_DENSITY = 5e-3  # m / dt²; contact is 10,000 times as stiff, so this makes it stiff compared with the gel
_DAMPING = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """The skin's outside under an object.

    Attributes
    ----------
    at_mm : float64 (N, 3)
        Positions of its points.
    penetration_mm : float
        How deep the deepest point lies inside the object.
    stirring_mm : float
        Greatest motion in the last step of rest.
    """

    at_mm: F64
    penetration_mm: float
    stirring_mm: float


def solved(dome: Dome, way: Way, edge_mm: float = EDGE_MM, gel_layers: int = 3) -> tuple[F64, State, State]:
    """Press and drag an object.

    Returns
    -------
    rest_mm : float64 (N, 3)
        The skin's points at rest.
    pressed, dragged : State

    Raises
    ------
    RuntimeError
        MuJoCo warned of a bad state.
    """
    mujoco.set_mju_user_warning(lambda _: None)  # MuJoCo would write a file here; `_moved` checks its counts
    mesh = meshed(dome, edge_mm * dome.radius_mm / 20, gel_layers)
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
    steps = math.ceil(max(math.hypot(press.drag_x_mm, press.drag_y_mm) / DRAG_MM, abs(press.twist_deg) / TWIST_DEG))
    dragged = _moved(model, data, end, steps, mesh) if steps else pressed
    return mesh.points_mm[: mesh.surface], pressed, dragged


def _moved(model: mujoco.MjModel, data: mujoco.MjData, to: F64, steps: int, mesh: Mesh) -> State:
    start, before = data.qpos[:4].copy(), data.qpos.copy()
    for k in range(steps + SETTLING):
        goal = start + (to - start) * min(1.0, (k + 1) / steps)
        data.qvel[:4] = (goal - data.qpos[:4]) / model.opt.timestep
        before = data.qpos.copy()
        mujoco.mj_step(model, data)
        data.qpos[:4] = goal
    # MuJoCo softens and counts stiffnesses that compression makes singular; any other warning is an error.
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
    angle, around = np.meshgrid(np.linspace(0, math.radians(70), 120), np.linspace(0, 2 * math.pi, 120))
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
        f'<geom type="sphere" size="{ball:.6g}" mass="0" contype="2" conaffinity="1" friction="{dome.friction} 0 0" '
        'solref="-1e9 -1e7" solimp="0.9999 0.9999 0.001"/>'
    )
    sliding = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    bodies = []
    for k, (point, mass, clamped) in enumerate(zip(mesh.points_mm, weight, mesh.clamped, strict=True)):
        free = f'<inertial pos="0 0 0" mass="{mass:.9g}" diaginertia="{mass:.9g} {mass:.9g} {mass:.9g}"/>{sliding}'
        inside = ("" if clamped else free) + (touching if k < mesh.surface else "")
        bodies.append(f'<body name="p{k}" pos="{_text(point)}">{inside}</body>')
    return (
        '<mujoco><option timestep="1" gravity="0 0 0" integrator="discrete" solver="Newton" cone="elliptic" '
        'impratio="10" iterations="100" tolerance="1e-10"><flag refsafe="disable"/></option><size memory="2G"/>'
        f'<worldbody><body name="object"><inertial pos="0 0 0" mass="1e6" diaginertia="1e8 1e8 1e8"/>{sliding}'
        f'<joint type="hinge" axis="0 0 1"/>{_solids(way)}</body>{"".join(bodies)}</worldbody><deformable>'
        f"{_flex('skin', mesh.skin, dome.stiffness_ratio, dome.poisson)}"
        f"{_flex('gel', mesh.gel, 1.0, dome.poisson)}</deformable></mujoco>"
    )


def _solids(way: Way) -> str:
    press, made = way.press, []
    a = math.radians(press.rotation_deg)
    turn = np.array(((math.cos(a), -math.sin(a), 0), (math.sin(a), math.cos(a), 0), (0, 0, 1)))
    # The object's orientation at the end of the path, where the hinge is at 0.
    own = Press(press.shape, tilt_x_deg=press.tilt_x_deg, tilt_y_deg=press.tilt_y_deg).tilt() @ turn
    for kind, sizes, middle, (about_x, about_y, _) in SOLIDS[way.object_name]:
        lying = Press(press.shape, tilt_x_deg=about_x, tilt_y_deg=about_y).tilt()
        axes = own @ lying
        made.append(
            f'<geom type="{kind}" size="{_text(np.array(sizes) * press.scale)}" '
            f'pos="{_text(own @ middle * press.scale)}" mass="0" contype="1" conaffinity="2" friction="1e-3 0 0" '
            f'xyaxes="{_text(axes[:, 0])} {_text(axes[:, 1])}"/>'
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
