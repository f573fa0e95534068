"""The contact in MuJoCo: as deep as the skin's law, whatever the object's own parameters say."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from support.calibrated_sensor import HALF
from support.felt_objects import weightless
from tacshade_edge.lab.simulator.sensor_model import flattened

mujoco: Any = pytest.importorskip("mujoco")


@pytest.mark.slow
def test_a_force_of_which_the_law_says_how_deep_presses_so_deep() -> None:
    from tools.studies.mujoco_forces import Pushed, skins_depth_mm

    world, depth_mm = Pushed(HALF, 0.2, free=False), 0.1 * HALF.geometry.size_mm
    world.soften(1.0, depth_mm)
    forces_n = np.array((1.0, 2.0))
    for force_n, law_mm in zip(forces_n, skins_depth_mm(HALF, forces_n), strict=True):
        world.push(float(force_n), 2.0)
        assert world.depth_mm == pytest.approx(law_mm, rel=0.05)


@pytest.mark.slow
def test_a_ball_slides_at_the_stated_coefficient() -> None:
    from tools.studies.mujoco_forces import Pushed, slide

    world = Pushed(replace(flattened(HALF), coulomb=0.8), 0.02, free=True)
    assert slide(world, 45.0, 0.8)[0] == pytest.approx(0.8, abs=0.01)


def test_the_objects_own_parameters_do_not_count() -> None:
    spec = weightless(replace(HALF, coulomb=0.6))
    body = spec.worldbody.add_body(pos=(0, 0, 0.0245))
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.005, 0, 0), friction=(2, 0.1, 0.1))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    (touch,) = (model.geom(k) for k in range(model.ngeom) if model.geom(k).name == "tacshade_touch")
    assert data.contact.friction[0, :2].tolist() == [0.6, 0.6]
    assert data.contact.solimp[0].tolist() == touch.solimp.tolist()
