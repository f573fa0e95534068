"""A sensor's files: MuJoCo loads them, and its tactile sensor is where the taxels are."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.calibrated_sensor import HALF
from support.felt_objects import depths_mm, written
from tacshade_edge.lab.mjcf.export import calibrated
from tacshade_edge.lab.mjcf.taxels import taxels_of
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball
from tacshade_edge.lab.simulator.sensor_model import SensorModel, flattened, random_model
from tacshade_edge.types import Calibration

PAD = flattened(HALF)


def with_object(path: Path, geom: str, shape: dict[str, Any], at_mm: tuple[float, ...]) -> Any:
    """MuJoCo's state with an object at a place that nothing moves."""
    mujoco = pytest.importorskip("mujoco")
    spec = mujoco.MjSpec.from_file(str(path))
    spec.option.gravity = (0, 0, 0)
    body = spec.worldbody.add_body(name="object", pos=np.array(at_mm) / 1e3)
    body.add_freejoint()
    body.add_geom(type=getattr(mujoco.mjtGeom, geom), **shape)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize("model", [HALF, PAD, random_model(3)], ids=["dome", "pad", "other"])
def test_mujoco_feels_a_ball_at_every_taxel_as_deep_as_it_is(
    model: SensorModel, tmp_path: Path
) -> None:
    taxels, radius_mm = taxels_of(model.geometry), model.form_mm[0]
    press = Press(ball(5.0), 2.0, -3.0, 2.5)
    at = (2.0, -3.0, press.lowest_z_mm(radius_mm) + 5.0)
    data = with_object(written(tmp_path, model), "mjGEOM_SPHERE", {"size": (0.005, 0, 0)}, at)
    felt = 1e3 * data.sensordata.reshape(3, -1)[0].reshape(taxels.points_mm.shape[:2])
    assert felt.max() > 2.4
    assert np.allclose(felt, depths_mm(taxels, press, radius_mm), atol=2e-3)


def test_the_flat_end_of_a_cylinder_is_felt_too(tmp_path: Path) -> None:
    press = Press(OBJECTS["cylinder"](), 1.0, 0.0, 2.0)
    at = (1.0, 0.0, press.lowest_z_mm(HALF.skin_radius_mm) + 15.0)
    size = {"size": (0.005, 0.015, 0)}
    data = with_object(written(tmp_path, HALF), "mjGEOM_CYLINDER", size, at)
    taxels = taxels_of(HALF.geometry)
    felt = 1e3 * data.sensordata.reshape(3, -1)[0].reshape(taxels.points_mm.shape[:2])
    assert np.allclose(felt, depths_mm(taxels, press, HALF.skin_radius_mm), atol=0.25)


def test_the_sensor_stands_where_its_flange_says(tmp_path: Path) -> None:
    turned = math.sqrt(0.5)
    path = written(tmp_path, HALF, 10.0, 0.0, 30.0, turned, 0.0, turned, 0.0)
    # A quarter turn about y: the tip points along the flange's x.
    data = with_object(path, "mjGEOM_SPHERE", {"size": (0.004, 0, 0)}, (32.0, 0.0, 30.0))
    assert 1e3 * data.sensordata.max() == pytest.approx(2.9, abs=0.1)
    assert data.ncon == 1


def test_nothing_touches_the_housing_of_a_pad_before_its_skin(tmp_path: Path) -> None:
    data = with_object(written(tmp_path, PAD), "mjGEOM_SPHERE", {"size": (0.006, 0, 0)}, (0, 0, 3))
    assert data.ncon == 1


def test_the_scene_presses_a_ball_on_the_sensor(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    written(tmp_path, HALF, 0.0, 0.0, 12.0, 1.0, 0.0, 0.0, 0.0)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 20)
    assert not data.sensordata.any()
    data.ctrl[0] = 0.003
    mujoco.mj_step(model, data, 200)
    # The shell outside is a millimetre deeper.
    assert 1.0 < 1e3 * data.sensordata.max() - 1 < 2.0


@pytest.mark.parametrize("model", [HALF, PAD], ids=["dome", "pad"])
def test_a_calibrated_sensor_has_its_geometry(model: SensorModel) -> None:
    known = Calibration(
        geometry=model.geometry,
        polarity="bright",
        binarisation="otsu",
        image_height_px=240,
        image_width_px=320,
        pitch_px=12.0,
        reference_white=np.zeros((240, 320), np.uint8),
        reference_grey=np.zeros((240, 320), np.uint8),
        noise_grey=0.0,
        alpha=15.0,
    )
    made = calibrated(replace(random_model(4), skin_decay_mm=1.7), known)
    assert made.skin_decay_mm == 1.7
    assert (made.image_height_px, made.image_width_px) == (240, 320)
    there, here = made.geometry, model.geometry
    assert there.disc == here.disc
    assert there.skin_radius_mm == here.skin_radius_mm
    assert there.camera_distance_mm == here.camera_distance_mm
    assert there.visible_radius_mm == pytest.approx(here.visible_radius_mm)
