"""Results from a sensor in MuJoCo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.calibrated_sensor import HALF
from support.felt_objects import written
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.mjcf import mujoco_sensor
from tacshade_edge.lab.mjcf.mujoco_sensor import MujocoSensor

mujoco: Any = pytest.importorskip("mujoco")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mjcf")
    written(folder, HALF, 0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0)
    return folder


@pytest.fixture
def scene(folder: Path) -> tuple[Any, Any]:
    model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def press(model: Any, data: Any, depth_mm: float) -> None:
    """Hold the scene's ball, which begins a millimetre above the skin, at a depth."""
    data.qpos[0], data.qvel[0] = (depth_mm + 1) / 1e3, 0.0
    data.time += 0.01
    mujoco.mj_forward(model, data)


def test_without_contact_every_height_is_zero(scene: tuple[Any, Any]) -> None:
    result = MujocoSensor(*scene).read()
    assert not result.in_contact
    assert (result.valid, result.depth_max_mm, result.objects) == (True, 0.0, ())
    assert np.nanmax(result.height_mm) == 0
    assert np.isnan(result.height_mm[0, 0])


def test_a_pressed_ball_is_one_object_of_its_depth(scene: tuple[Any, Any]) -> None:
    felt = MujocoSensor(*scene)
    press(*scene, 2.0)
    result = felt.read()
    (ball,) = result.objects
    assert result.depth_max_mm == pytest.approx(2.0, abs=0.1)
    assert ball.centroid_mm[0] == pytest.approx(0.0, abs=0.1)
    assert result.points_mm.shape == (result.contact.sum(), 3)
    assert result.touch is not None
    assert result.touch["depth_mm"] == pytest.approx(2.0, abs=0.1)
    assert result.touch["tilt_x_deg"] == pytest.approx(0.0, abs=0.5)
    assert result.geometry.disc == HALF.geometry.disc
    assert result.pose is not None
    assert (result.pose.z_mm, result.t_ns) == (0.0, 10_000_000)
    assert result.shear_mm is not None
    press(*scene, 0.0)
    assert felt.read(shear=False).shear_mm is None


def test_results_are_numbered_and_objects_followed(scene: tuple[Any, Any]) -> None:
    felt = MujocoSensor(*scene)
    seen = []
    for depth_mm in (1.0, 1.2, 1.4):
        press(*scene, depth_mm)
        seen.append(felt.read())
    assert [result.seq for result in seen] == [0, 1, 2]
    assert [result.objects[0].id for result in seen] == [1, 1, 1]


def test_a_reset_forgets_the_contact(scene: tuple[Any, Any]) -> None:
    model, data = scene
    felt = MujocoSensor(model, data)
    press(model, data, 2.0)
    felt.read()
    mujoco.mj_resetData(model, data)
    # Moved aside while nobody looked: no drag, since the simulation began anew.
    model.body("ball").pos[0] = 0.002
    data.qpos[0] = 0.003
    mujoco.mj_forward(model, data)
    result = felt.read()
    assert result.touch is not None
    assert abs(result.touch["shear_x_mm"] or 0.0) < 0.25  # what pressing alone does off the middle
    model.body("ball").pos[0] = 0.0035
    data.time += 0.01
    mujoco.mj_forward(model, data)
    dragged = felt.read().touch
    assert dragged is not None
    assert (dragged["shear_x_mm"] or 0.0) > (result.touch["shear_x_mm"] or 0.0) + 0.5


def test_a_sensor_keeps_its_prefix_in_another_model(folder: Path) -> None:
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="hand", pos=(0, 0, 0.2)).add_frame()
    child = mujoco.MjSpec.from_file(str(folder / "sensor.xml"))
    spec.attach(child, prefix="left/", frame=spec.body("hand").first_frame())
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pose = MujocoSensor(model, data, "left/tacshade").pose()
    assert pose.z_mm == pytest.approx(200.0)
    with pytest.raises(ConfigError, match="tacshade: found no such sensor in the model"):
        MujocoSensor(model, data)


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ('version":1', 'version":2', "Invalid enum value 2"),
        ('skin_decay_mm":2.2', 'skin_decay_mm":-1', "skin_decay_mm"),
        ('"model":{', '"model":', "Expected `object`"),
    ],
)
def test_changed_files_are_refused_in_one_line(
    old: str, new: str, found: str, folder: Path, tmp_path: Path
) -> None:
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    file = tmp_path / "sensor.xml"
    before = file.read_text()
    file.write_text(before.replace(old, new))
    assert file.read_text() != before
    model = mujoco.MjModel.from_xml_path(str(file))
    with pytest.raises(ConfigError, match=found) as refused:
        MujocoSensor(model, mujoco.MjData(model))
    assert "simulate --mjcf" in str(refused.value)


def test_files_of_a_version_with_other_taxels_are_refused(
    scene: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mujoco_sensor, "SHELLS", 8)
    with pytest.raises(ConfigError, match="numbers of the tactile sensor, expected"):
        MujocoSensor(*scene)
