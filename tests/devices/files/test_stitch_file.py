import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support import stitch_until_killed
from support.bumpy_surface import grid_poses, press_of

from tacshade_edge.core.stitching.press_points import PressPoints
from tacshade_edge.devices.files.stitch_file import PRESSES, SESSION, SessionInfo, StitchFile, open_session, read_info
from tacshade_edge.errors import DecodeError, DeviceError
from tacshade_edge.rigid import Rigid

POSES = grid_poses()[:3]
POINTS = [press_of(pose, k) for k, pose in enumerate(POSES)]


def info(name: str = "one", begun: int = 5) -> SessionInfo:
    return SessionInfo(name, begun, 77, 20.0)


def written(folder: Path) -> StitchFile:
    file = StitchFile.create(folder, info())
    for points, pose in zip(POINTS, POSES, strict=True):
        file.append(points, pose)
    file.close()  # it buffers nothing: a kill loses no more than this
    return file


def same(found: list[tuple[PressPoints, Rigid]], count: int) -> None:
    assert len(found) == count
    for (points, pose), expected, true in zip(found, POINTS, POSES, strict=False):
        for name in ("points_mm", "normals", "confidence"):
            np.testing.assert_array_equal(getattr(points, name), getattr(expected, name))
        np.testing.assert_array_equal(pose.rotation, true.rotation)
        np.testing.assert_array_equal(pose.translation_mm, true.translation_mm)


def test_every_press_comes_back_bit_for_bit(tmp_path: Path) -> None:
    written(tmp_path / "one")
    file, found = StitchFile.resume(tmp_path / "one")
    same(found, 3)
    assert file.info == info()


@pytest.mark.parametrize("lost", [1, 9, 5000])
def test_a_torn_press_is_cut_off_and_the_session_goes_on(tmp_path: Path, lost: int) -> None:
    written(tmp_path / "one")
    path = tmp_path / "one" / PRESSES
    path.write_bytes(path.read_bytes()[:-lost])
    file, found = StitchFile.resume(tmp_path / "one")
    same(found, 2)
    file.append(POINTS[2], POSES[2])
    file.close()
    same(StitchFile.resume(tmp_path / "one")[1], 3)


def test_a_damaged_press_ends_what_is_trusted(tmp_path: Path) -> None:
    written(tmp_path / "one")
    path = tmp_path / "one" / PRESSES
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    same(StitchFile.resume(tmp_path / "one")[1], 1)


def test_what_was_acknowledged_survives_kill_9(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, stitch_until_killed.__file__, str(tmp_path / "one")],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
    ) as process:
        assert process.stdout is not None
        told = [process.stdout.readline() for _ in range(60)]
        process.kill()
        told += process.stdout.readlines()
    acknowledged = told.count(b"added\n")
    file, found = StitchFile.resume(tmp_path / "one")
    assert acknowledged <= len(found) <= acknowledged + 1
    poses = grid_poses()
    for k, (touch, pose) in enumerate(found):
        np.testing.assert_array_equal(pose.translation_mm, poses[k % len(poses)].translation_mm)
        np.testing.assert_array_equal(touch.points_mm, press_of(poses[k % len(poses)], k % len(poses)).points_mm)
    file.append(POINTS[0], POSES[0])
    file.close()


def test_only_an_open_session_is_found(tmp_path: Path) -> None:
    assert open_session(tmp_path) is None
    assert open_session(tmp_path / "none") is None
    StitchFile.create(tmp_path / "old", info("old", 1))
    newer = StitchFile.create(tmp_path / "new", info("new", 2))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / SESSION).write_text("{")
    assert open_session(tmp_path) == tmp_path / "new"
    newer.end()
    assert read_info(tmp_path / "new").state == "ended"
    assert open_session(tmp_path) == tmp_path / "old"


def test_removing_leaves_what_is_not_ours(tmp_path: Path) -> None:
    file = written(tmp_path / "one")
    (tmp_path / "one" / "notes.txt").write_text("mine")
    file.remove()
    assert [p.name for p in (tmp_path / "one").iterdir()] == ["notes.txt"]
    written(tmp_path / "two").remove()
    assert not (tmp_path / "two").exists()


def test_what_is_there_is_not_overwritten(tmp_path: Path) -> None:
    written(tmp_path / "one")
    with pytest.raises(DeviceError, match="one: cannot be written"):
        StitchFile.create(tmp_path / "one", info())


@pytest.mark.parametrize("text", ["", "[]", '{"name": "x"}', "\x00"])
def test_a_damaged_description(tmp_path: Path, text: str) -> None:
    (tmp_path / SESSION).write_text(text)
    with pytest.raises(DecodeError, match="expected a stitching session"):
        read_info(tmp_path)


def test_another_version(tmp_path: Path) -> None:
    written(tmp_path / "one")
    path = tmp_path / "one" / SESSION
    path.write_text(path.read_text().replace('"version": 1', '"version": 2'))
    with pytest.raises(DecodeError, match="found version 2, expected 1"):
        StitchFile.resume(tmp_path / "one")
