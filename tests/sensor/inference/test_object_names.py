from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.calibrated_sensor import calibrated, pressed, unloaded
from tacshade_edge.calibration import loading
from tacshade_edge.calibration.files import calibration_file, objects_file
from tacshade_edge.calibration.files.objects_file import Known, path_beside
from tacshade_edge.sensor.geometry.disc import labels_by_cell
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.inference.object_names import load_metric
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.recognition.description import describe
from tacshade_edge.sensor.recognition.naming import describe_touch
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import Frame, Reconstruction


def step(made: Reconstructor, name: str, depth_mm: float = 3.0) -> Reconstruction:
    image = pressed(name, depth_mm).image if name else unloaded()
    found = made.step(Frame(0, 0, 0, image))
    assert found is not None
    return found


@pytest.fixture(scope="module")
def known() -> Known:
    made, known = make_reconstructor(calibrated(), PROFILES["fast"]), {}
    for name in ("ball", "cube"):
        seen = [step(made, name, depth_mm).height for depth_mm in (2.5, 3.5)]
        found = [describe_touch(each, made.rays, made.calibration.geometry) for each in seen]
        known = objects_file.taught(known, "fast", name, np.stack(found))
    return known


def test_taught_objects_are_named(known: Known) -> None:
    made = make_reconstructor(replace(calibrated(), known=known), PROFILES["fast"])
    for name in ("ball", "cube"):
        (found,) = step(made, name).objects
        assert found.name == name
        assert found.probability is not None
        assert 0.5 < found.probability <= 1
    assert step(made, "").objects == ()
    (bar,) = step(made, "bar").objects
    assert (bar.name, bar.probability) == (None, None)


def test_parts_of_one_thing_take_its_name_and_things_of_their_own_keep_theirs(
    known: Known,
) -> None:
    made = make_reconstructor(calibrated(), PROFILES["fast"])
    two = step(made, "two_balls")
    assert len(two.objects) == 2
    whole = describe_touch(two.height, made.rays, made.calibration.geometry)
    assert whole is not None
    dumbbell = objects_file.taught(known, "fast", "dumbbell", np.stack([whole, whole]))
    made = make_reconstructor(replace(calibrated(), known=dumbbell), PROFILES["fast"])
    assert [each.name for each in step(made, "two_balls").objects] == ["dumbbell"] * 2

    geometry, cloud = made.calibration.geometry, two.cloud
    cells = labels_by_cell(cloud.points_mm, cloud.labels, made.grid, geometry) == 1
    part = describe(two.height.height_mm, cells, made.rays, geometry)
    assert part is not None
    balls = objects_file.taught({}, "fast", "small_ball", np.stack([part, part]))
    made = make_reconstructor(replace(calibrated(), known=balls), PROFILES["fast"])
    assert [each.name for each in step(made, "two_balls").objects] == ["small_ball"] * 2


def test_another_profile_knows_nothing_of_them(known: Known) -> None:
    made = make_reconstructor(replace(calibrated(), known=known), PROFILES["balanced"])
    assert made.namer is None
    (found,) = step(made, "ball").objects
    assert (found.name, found.probability) == (None, None)


def test_the_file_beside_a_calibration_is_loaded_with_it(known: Known, tmp_path: Path) -> None:
    path = tmp_path / "cal.npz"
    saved = calibration_file.save(path, calibrated())
    objects_file.save(path_beside(path), known)
    loaded = loading.load(path)
    assert {p: [o.name for o in objects] for p, objects in loaded.known.items()} == {
        "fast": ["ball", "cube"]
    }
    assert loaded.crc32 == saved.crc32
    assert calibration_file.save(tmp_path / "copy.npz", loaded).crc32 == saved.crc32
    assert calibration_file.load(tmp_path / "copy.npz").known == {}


def test_the_shipped_metric_is_whole() -> None:
    metric = load_metric()
    assert metric.axes.shape == (len(metric.middle), len(metric.between))
    assert (np.diff(metric.scores, axis=1) >= 0).all()
    assert metric.trust > 0


@pytest.mark.slow
def test_nothing_of_it_is_imported_without_taught_objects() -> None:
    code = (
        "import sys; from support.calibrated_sensor import calibrated, pressed;"
        "from tacshade_edge.sensor.profiles import PROFILES;"
        "from tacshade_edge.sensor.inference.network import make_reconstructor;"
        "from tacshade_edge.types import Frame;"
        "made = make_reconstructor(calibrated(), PROFILES['fast']);"
        "assert made.step(Frame(0, 0, 0, pressed('ball', 3.0).image)).objects;"
        "assert not [name for name in sys.modules if 'recognition' in name]"
    )
    root = Path(__file__).parents[3]
    subprocess.run([sys.executable, "-c", code], cwd=root, check=True)
