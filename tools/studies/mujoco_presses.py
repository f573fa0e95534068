"""Press objects on the sensor in MuJoCo and on the simulator, at equal poses, and compare.

.venv/bin/python -m tools.studies.mujoco_presses

It needs the extra `mujoco`. Balls, cylinders on end, rods that lie, and plates press and tilt at
random, and some are dragged; both sides answer at the cells in the disc of the sensor in MuJoCo.
Times are of the processor, so that other programs do not count.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import mujoco
import numpy as np

from support.felt_objects import true_map, weightless
from tacshade_edge.lab.mjcf.mujoco_sensor import MujocoSensor
from tacshade_edge.lab.mjcf.taxels import taxels_of
from tacshade_edge.lab.simulator.press import OBJECTS, Press, Shape, ball
from tacshade_edge.lab.simulator.sensor_model import SensorModel, flattened, random_model
from tacshade_edge.lab.simulator.truth import shear_mm
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.types import F64

EACH: Final = 15
DRAGGED: Final = 12
LEAST_CELLS: Final = 12
_LENGTH_MM = 14.0
HELD_MM, SLID_MM = 0.3, 5.0
_TIMED = 200
_GEOM = mujoco.mjtGeom


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """An object in both worlds: as the simulator's shape, and as a geom of MuJoCo with its size in
    mm and its pose in the shape's frame.
    """

    shape: Shape
    geom: Any
    size_mm: tuple[float, float, float]
    object_T_geom: Rigid


def a_ball(rng: np.random.Generator) -> Solid:
    """A ball of radius 3 to 8 mm."""
    radius_mm = float(rng.uniform(3, 8))
    return Solid(ball(radius_mm), _GEOM.mjGEOM_SPHERE, (radius_mm, 0, 0), shift(0, 0, radius_mm))


def a_cylinder(rng: np.random.Generator) -> Solid:
    """The paper's cylinder, on end."""
    del rng
    return Solid(OBJECTS["cylinder"](), _GEOM.mjGEOM_CYLINDER, (5, 15, 0), shift(0, 0, 15))


def a_rod(rng: np.random.Generator) -> Solid:
    """A rod with round ends that lies along x, of radius 3 to 6 mm."""
    radius_mm, half_mm = float(rng.uniform(3, 6)), _LENGTH_MM / 2

    def sdf(p: F64) -> F64:
        along = p[:, 0] - np.clip(p[:, 0], -half_mm, half_mm)
        return np.asarray(np.sqrt(along**2 + p[:, 1] ** 2 + (p[:, 2] - radius_mm) ** 2) - radius_mm)

    lying = shift(0, 0, radius_mm) @ turn((0.0, math.pi / 2, 0.0))
    return Solid(Shape("rod", sdf), _GEOM.mjGEOM_CAPSULE, (radius_mm, half_mm, 0), lying)


def a_plate(rng: np.random.Generator) -> Solid:
    """A disc of radius 25 mm."""
    del rng
    return Solid(OBJECTS["plate"](), _GEOM.mjGEOM_CYLINDER, (25, 15, 0), shift(0, 0, 15))


KINDS: Final[Mapping[str, Callable[[np.random.Generator], Solid]]] = {
    "ball": a_ball,
    "cylinder on end": a_cylinder,
    "lying rod": a_rod,
    "plate": a_plate,
}


class World:
    """A sensor in MuJoCo, and one object that stays where it is put."""

    def __init__(self, model: SensorModel, solid: Solid) -> None:
        spec = weightless(model)
        body = spec.worldbody.add_body(name="object")
        body.add_freejoint()
        at = solid.object_T_geom.seven()
        size = np.array(solid.size_mm) / 1e3
        body.add_geom(type=solid.geom, size=size, pos=np.array(at[:3]) / 1e3, quat=at[3:])
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.sensor = MujocoSensor(self.model, self.data)

    def put(self, pose: Rigid) -> None:
        """Put the object at ``sensor_T_object``, a time step later."""
        at = pose.seven()
        self.data.qpos[:3], self.data.qpos[3:] = np.array(at[:3]) / 1e3, at[3:]
        self.data.time += 0.01
        mujoco.mj_forward(self.model, self.data)


def pose_of(press: Press, radius_mm: float) -> Rigid:
    """The object of a press in the sensor frame."""
    at = np.array((press.x_mm, press.y_mm, press.origin_z_mm(radius_mm)))
    about_z = turn((0.0, 0.0, math.radians(press.rotation_deg)))
    return Rigid(press.tilt() @ about_z.rotation, at)


def drawn(solid: Solid, model: SensorModel, rng: np.random.Generator) -> Press:
    """Draw a press whose contact lies in the disc."""
    size = model.geometry.size_mm / 20
    x_mm, y_mm = (float(v) * size for v in rng.uniform(-4, 4, 2))
    tilt_x_deg, tilt_y_deg = (float(v) for v in rng.uniform(-8, 8, 2))
    return Press(
        solid.shape,
        x_mm,
        y_mm,
        float(rng.uniform(1.5, 4)) * size,
        rotation_deg=float(rng.uniform(0, 180)),
        tilt_x_deg=tilt_x_deg,
        tilt_y_deg=tilt_y_deg,
    )


@dataclass(frozen=True, slots=True)
class Agreement:
    """One press: median and greatest error of the height in the true contact, mm; error of the
    greatest height; intersection over union of both contacts; and for a dragged one the mean of the
    true shear in the contact, and the median length of its error.
    """

    height_mm: float
    worst_mm: float
    depth_mm: float
    iou: float
    sheared_mm: float = math.nan
    shear_mm: float = math.nan


def agreement(model: SensorModel, solid: Solid, press: Press) -> Agreement | None:
    """Compare one press in both worlds; None if it touches fewer cells than `LEAST_CELLS`."""
    taxels = taxels_of(model.geometry)
    true, inside = true_map(model, taxels, press), taxels.inside
    touches, height = true.touches, true.height_mm
    if touches.sum() < LEAST_CELLS:
        return None
    world, radius_mm = World(model, solid), model.form_mm[0]
    if press.is_dragged:
        # Where it touched first, as deep.
        back = shift(-press.drag_x_mm, -press.drag_y_mm, 0)
        world.put(back @ pose_of(press, radius_mm))
        world.sensor.read()
    world.put(pose_of(press, radius_mm))
    found = world.sensor.read(shear=press.is_dragged)
    off, contact = np.abs(found.height_mm[inside] - height), found.contact[inside]
    made = Agreement(
        height_mm=float(np.median(off[touches])),
        worst_mm=float(off[touches].max()),
        depth_mm=abs(float(np.nanmax(found.height_mm)) - float(height.max())),
        iou=float((contact & touches).sum() / (contact | touches).sum()),
    )
    if not press.is_dragged or found.shear_mm is None:
        return made
    shear = shear_mm(true.skin, true.points_mm, model.friction)[touches]
    beside = np.linalg.norm(found.shear_mm[inside][touches] - shear, axis=1)
    return replace(
        made,
        sheared_mm=float(np.linalg.norm(shear.mean(axis=0))),
        shear_mm=float(np.median(beside)),
    )


def presses(model: SensorModel, kind: str, seed: int) -> Iterator[Agreement]:
    """Compare `EACH` random presses of a kind."""
    rng, done = np.random.default_rng(seed), 0
    while done < EACH:
        solid = KINDS[kind](rng)
        if (made := agreement(model, solid, drawn(solid, model, rng))) is not None:
            done += 1
            yield made


def drags(model: SensorModel, seed: int) -> Iterator[Agreement]:
    """Compare `DRAGGED` balls that dragged the skin by 0.3 to 3 mm."""
    rng, done = np.random.default_rng(seed), 0
    while done < DRAGGED:
        solid, angle = a_ball(rng), float(rng.uniform(0, 2 * math.pi))
        far_mm = float(rng.uniform(0.3, 3))
        press = replace(
            drawn(solid, model, rng),
            drag_x_mm=far_mm * math.cos(angle),
            drag_y_mm=far_mm * math.sin(angle),
        )
        if (made := agreement(model, solid, press)) is not None:
            done += 1
            yield made


def row(name: str, some: list[Agreement]) -> tuple[str, ...]:
    """A line of the table."""
    heights, ious = [one.height_mm for one in some], [one.iou for one in some]
    return (
        name,
        str(len(some)),
        f"{np.median(heights):.3f}",
        f"{max(heights):.3f}",
        f"{np.median([one.worst_mm for one in some]):.2f}",
        f"{np.median([one.depth_mm for one in some]):.3f}",
        f"{np.median(ious):.2f}",
        f"{min(ious):.2f}",
    )


def milliseconds(action: Callable[[], object]) -> float:
    """The processor's time of an action, in ms, as the mean of many."""
    action()
    began = time.process_time()
    for _ in range(_TIMED):
        action()
    return 1e3 * (time.process_time() - began) / _TIMED


def times(model: SensorModel) -> Iterator[tuple[str, str]]:
    """What a step costs, under a ball that is 2.5 mm deep and moves to and fro."""
    solid = Solid(ball(6.0), _GEOM.mjGEOM_SPHERE, (6.0, 0, 0), shift(0, 0, 6.0))
    world, radius_mm, moved = World(model, solid), model.form_mm[0], iter(range(10**6))
    far_mm = HELD_MM

    def put() -> None:
        x_mm = far_mm * math.sin(next(moved) / 30)
        world.put(pose_of(Press(solid.shape, x_mm, 0.0, 2.5), radius_mm))

    def read() -> None:
        put()
        world.sensor.read()

    def plain() -> None:
        put()
        world.sensor.read(shear=False)

    for name, action in (("MuJoCo's step alone", put), ("step and `read(shear=False)`", plain)):
        yield name, f"{milliseconds(action):.2f}"
    for far_mm, does in ((HELD_MM, "drags the skin"), (SLID_MM, "slides over the skin")):
        yield (
            f"step and `read()`, the ball {does}, {far_mm:g} mm to and fro",
            f"{milliseconds(read):.2f}",
        )


def main() -> None:
    """Print the tables."""
    columns = (
        "object",
        "presses",
        "median error of h, mm",
        "of the worst press",
        "greatest error in the contact, mm",
        "error of the depth, mm",
        "IoU of the contact",
        "of the worst press",
    )
    for title, model, seed in (
        ("A dome", SensorModel(), 1),
        ("Another dome", random_model(7), 2),
        ("A pad", flattened(SensorModel()), 3),
    ):
        by_kind = {kind: list(presses(model, kind, seed)) for kind in KINDS}
        every = [one for some in by_kind.values() for one in some]
        lines = [row(kind, some) for kind, some in by_kind.items()]
        print(f"## {title}\n\n{markdown(columns, [*lines, row('all', every)])}\n")
    pulled = list(drags(SensorModel(), 4))
    lines = [
        (
            str(len(pulled)),
            f"{np.median([one.sheared_mm for one in pulled]):.2f}",
            f"{np.median([one.shear_mm for one in pulled]):.3f}",
            f"{max(one.shear_mm for one in pulled):.3f}",
        )
    ]
    heads = ("dragged balls", "mean shear, mm", "median error, mm", "of the worst press")
    print(f"## Shear, a dome\n\n{markdown(heads, lines)}\n")
    print(f"## Time, a dome\n\n{markdown(('', 'processor, ms'), list(times(SensorModel())))}")


if __name__ == "__main__":
    main()
