"""Press and drag a ball on the sensor in MuJoCo by given forces, and compare with the skin's laws.

.venv/bin/python -m tools.studies.mujoco_forces

It needs the extra `mujoco`. The skin states its pressure up to one factor, the stiffness of its
gel: so a force of 1 N is taken to press the ball in by a tenth of the skin's radius in both worlds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

import mujoco
import numpy as np

from support.felt_objects import weightless
from tacshade_edge.lab.simulator.press import Press, ball
from tacshade_edge.lab.simulator.sensor_model import SensorModel, flattened
from tacshade_edge.lab.simulator.skin import net_pull
from tacshade_edge.lab.simulator.truth import skin_under
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.types import F64

BALL_MM: Final = 6.0
FORCES_N: Final = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0)
MASSES_KG: Final = (0.02, 1.0)
COEFFICIENTS: Final = (0.8, 1.5, 3.0)
ANGLES_DEG: Final = (0.0, 45.0)
_SETTLED_S, _RAMP_S, _STEP_S = 2.0, 1.0, 0.002


class Pushed:
    """A ball over the middle of a sensor, which forces along x, y and down push."""

    def __init__(self, model: SensorModel, mass_kg: float, *, free: bool) -> None:
        spec = weightless(model)
        spec.option.timestep = _STEP_S
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
        apex_mm = model.geometry.apex_z_mm
        body = spec.worldbody.add_body(name="ball", pos=(0, 0, (apex_mm + BALL_MM) / 1e3))
        for axis in ((0, 0, -1), (1, 0, 0), (0, 1, 0))[: 3 if free else 1]:
            body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
        size = (BALL_MM / 1e3, 0, 0)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=size, mass=mass_kg)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def push(self, force_n: float, for_s: float) -> None:
        """Push down with a force for a time."""
        self.data.qfrc_applied[0] = force_n
        mujoco.mj_step(self.model, self.data, round(for_s / _STEP_S))

    @property
    def depth_mm(self) -> float:
        """How deep the ball lies in the undeformed skin."""
        return -1e3 * float(self.data.contact.dist[0]) if self.data.ncon else 0.0

    def ratio(self) -> float:
        """The contact's force along the skin over that across."""
        force = np.zeros(6)
        mujoco.mj_contactForce(self.model, self.data, 0, force)
        return float(np.hypot(force[1], force[2]) / force[0]) if force[0] > 0 else 0.0

    def soften(self, force_n: float, depth_mm: float) -> None:
        """Set the contact's time constant: a force presses this deep, a tenth of the radius."""
        bodies = [self.model.body(name).id for name in ("tacshade", "ball")]
        mass_kg = 1 / self.model.body_invweight0[bodies, 0].sum()
        touch: Any = self.model.geom("tacshade_touch")
        touch.solref[0] = math.sqrt(10.9 * 1e-3 * depth_mm * mass_kg / force_n)


def skins_depth_mm(model: SensorModel, forces: F64) -> F64:
    """How deep forces press the ball by the skin's own law, of which 1 N takes a tenth of the
    skin's radius.
    """
    size_mm = model.geometry.size_mm
    depth_mm = np.linspace(0.01, 0.22, 12) * size_mm
    pull = []
    for each in (*depth_mm, 0.1 * size_mm):
        skin = skin_under(model, (Press(ball(BALL_MM), 0.0, 0.0, float(each)),))
        pull.append(float(np.maximum(net_pull(skin, model.skin_decay_mm), 0).sum()))
    return np.interp(forces, np.array(pull[:-1]) / pull[-1], depth_mm)


def forces() -> Iterator[tuple[str, ...]]:
    """A line of the table for each skin and force."""
    for name, model in (("dome", SensorModel()), ("pad", flattened(SensorModel()))):
        law = skins_depth_mm(model, np.array(FORCES_N))
        worlds = [Pushed(model, mass_kg, free=False) for mass_kg in MASSES_KG]
        for world in worlds:
            world.soften(1.0, 0.1 * model.geometry.size_mm)
        as_written = Pushed(model, MASSES_KG[0], free=False)
        for force_n, depth_mm in zip(FORCES_N, law, strict=True):
            found = []
            for world in (*worlds, as_written):
                mujoco.mj_resetData(world.model, world.data)
                world.push(force_n, _SETTLED_S)
                found.append(f"{world.depth_mm:.2f}")
            yield name, f"{force_n:g}", f"{depth_mm:.2f}", *found


def slide(world: Pushed, angle_deg: float, most: float) -> tuple[float, float]:
    """Pull harder and harder: the greatest ratio of the contact's forces, and the speed in mm/s at
    which the ball creeps at half the stated one.
    """
    mujoco.mj_resetData(world.model, world.data)
    world.push(1.0, 1.0)
    along = np.array((math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))))
    ratios, creep_mm_s = [], math.nan
    for pull in np.linspace(0, 1.5 * most, round(_RAMP_S / _STEP_S)):
        world.data.qfrc_applied[1:] = pull * along
        mujoco.mj_step(world.model, world.data)
        ratios.append(world.ratio())
        if math.isnan(creep_mm_s) and pull > most / 2:
            creep_mm_s = 1e3 * float(np.linalg.norm(world.data.qvel[1:]))
        if pull > most * 1.2:
            break
    return max(ratios), creep_mm_s


def frictions() -> Iterator[tuple[str, ...]]:
    """A line of the table for each coefficient, on a pad."""
    for stated in COEFFICIENTS:
        world = Pushed(replace(flattened(SensorModel()), coulomb=stated), MASSES_KG[0], free=True)
        found = [slide(world, angle_deg, stated) for angle_deg in ANGLES_DEG]
        yield f"{stated:g}", *(f"{ratio:.2f}" for ratio, _ in found), f"{found[0][1]:.1f}"


def main() -> None:
    """Print the tables."""
    masses = [f"{1e3 * mass:g} g, mm" for mass in MASSES_KG]
    heads = ("skin", "force, N", "the skin's law, mm", *masses, "20 g as written, mm")
    print(f"### Force\n\n{markdown(heads, list(forces()))}\n")
    slides = ("stated", "slides along x at", "at 45° at", "creeps at half of it, mm/s")
    print(f"### Friction\n\n{markdown(slides, list(frictions()))}")


if __name__ == "__main__":
    main()
