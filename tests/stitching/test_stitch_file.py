import errno
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from support.bumpy_surface import grid_poses, press_of
from tacshade_edge.errors import DecodeError, DeviceError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.rigid import Rigid
from tacshade_edge.stitching.press_points import PressPoints
from tacshade_edge.stitching.stitch_file import (
    PRESSES,
    SESSION,
    SessionInfo,
    StitchFile,
    open_session,
    read_info,
)

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


@pytest.mark.parametrize("lost", [1, 9, 5000])
def test_a_torn_press_is_kept_beside_and_the_session_goes_on(tmp_path: Path, lost: int) -> None:
    written(tmp_path / "one")
    path = tmp_path / "one" / PRESSES
    torn = path.read_bytes()[:-lost]
    path.write_bytes(torn)
    file, found = StitchFile.resume(tmp_path / "one")
    same(found, 2)
    assert (tmp_path / "one" / f"{PRESSES}.damaged-1").read_bytes() == torn
    file.append(POINTS[2], POSES[2])
    file.close()
    same(StitchFile.resume(tmp_path / "one")[1], 3)


# In the first press's magic, size, checksum, pose and points;
# the others are of 108 + 600 * 28 bytes, too.
@pytest.mark.parametrize(
    ("press", "place", "bit"),
    [(0, 0, 0), (0, 4, 0), (1, 6, 4), (1, 7, 7), (1, 8, 3), (2, 30, 1), (2, 9000, 6)],
)
def test_a_flipped_bit_costs_one_press(
    tmp_path: Path, press: int, place: int, bit: int, caplog: pytest.LogCaptureFixture
) -> None:
    written(tmp_path / "one")
    path = tmp_path / "one" / PRESSES
    data = bytearray(path.read_bytes())
    one_press = len(data) // 3
    data[press * one_press + place] ^= 1 << bit
    path.write_bytes(data)
    with caplog.at_level("WARNING"):
        file, found = StitchFile.resume(tmp_path / "one")
    expected = [pose.translation_mm.tolist() for k, pose in enumerate(POSES) if k != press]
    assert [pose.translation_mm.tolist() for _, pose in found] == expected
    assert f"{one_press} bytes are damaged or incomplete" in caplog.text
    assert (
        f"continuing with 2 whole presses and keeping the old file as {PRESSES}.damaged-1"
        in caplog.text
    )
    assert (tmp_path / "one" / f"{PRESSES}.damaged-1").read_bytes() == data
    file.append(POINTS[press], POSES[press])
    file.close()
    caplog.clear()
    assert len(StitchFile.resume(tmp_path / "one")[1]) == 3
    assert not caplog.records


def test_a_press_is_taken_back(tmp_path: Path) -> None:
    file = StitchFile.create(tmp_path / "one", info())
    for k in (0, 2):
        file.append(POINTS[k], POSES[k])
    file.take_back()
    for k in (1, 2):
        file.append(POINTS[k], POSES[k])
    file.close()
    file, found = StitchFile.resume(tmp_path / "one")
    same(found, 3)
    assert file.info == info()


def test_a_full_disk_leaves_no_session_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr("tacshade_edge.stitching.stitch_file.write_whole", full)
        with pytest.raises(DeviceError, match="No space left on device"):
            StitchFile.create(tmp_path / "one", info())
    assert [*tmp_path.iterdir()] == []
    file = written(tmp_path / "one")
    monkeypatch.setattr("tacshade_edge.files.atomic_files.FREE_FLOOR_BYTES", 2**62)
    with pytest.raises(DeviceError, match="MiB free on the disk, expected") as caught:
        file.append(POINTS[0], POSES[0])
    assert caught.value.code == ReasonCode.DISK_FULL
    with pytest.raises(DeviceError, match="MiB free on the disk, expected"):
        StitchFile.create(tmp_path / "two", info())
    same(StitchFile.resume(tmp_path / "one")[1], 3)


def test_a_folder_that_somebody_deleted(tmp_path: Path) -> None:
    file = StitchFile.create(tmp_path / "one", info())
    file.append(POINTS[0], POSES[0])
    shutil.rmtree(tmp_path / "one")
    assert file.gone
    with pytest.raises(DeviceError, match="the session's files are gone"):
        file.append(POINTS[0], POSES[0])
    file.remove()


def test_only_an_open_session_is_found(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert open_session(tmp_path, "left") is None
    assert open_session(tmp_path / "none", "left") is None
    StitchFile.create(tmp_path / "old", info("old", 1))
    newer = StitchFile.create(tmp_path / "new", info("new", 2))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / SESSION).write_text("{")
    with caplog.at_level("WARNING"):
        assert open_session(tmp_path, "left") == tmp_path / "new"
    assert f"skipping a session: {tmp_path / 'other' / SESSION}" in caplog.text
    newer.end()
    assert read_info(tmp_path / "new").state == "ended"
    assert open_session(tmp_path, "left") == tmp_path / "old"
    StitchFile.create(tmp_path / "right", SessionInfo("right", 9, 77, 20.0, "right"))
    assert open_session(tmp_path, "left") == tmp_path / "old"
    assert open_session(tmp_path, "right") == tmp_path / "right"


def test_removing_leaves_what_is_not_ours(tmp_path: Path) -> None:
    file = written(tmp_path / "one")
    (tmp_path / "one" / "notes.txt").write_text("mine")
    file.remove()
    assert [p.name for p in (tmp_path / "one").iterdir()] == ["notes.txt"]
    written(tmp_path / "two")
    with pytest.raises(DeviceError, match="two: cannot write it"):
        StitchFile.create(tmp_path / "two", info())
    StitchFile.resume(tmp_path / "two")[0].remove()
    assert not (tmp_path / "two").exists()


_V1 = (
    '{"name": "x", "begun_wall_ns": 5, "calibration_crc32": 7, "skin_radius_mm": 20.0, "state": '
    '"open", "version": 1'
)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"name": "x"}',
        "[" * 100_000,
        _V1,
        _V1 + ', "more": 1}',
        *(
            _V1.replace(a, b) + "}"
            for a, b in (("20.0", "NaN"), ("20.0", "1e300"), ('"open"', '"shut"'), ("7", "-1"))
        ),
    ],
)
def test_a_damaged_description(tmp_path: Path, text: str) -> None:
    (tmp_path / SESSION).write_text(text)
    with pytest.raises(DecodeError, match="expected a stitching session"):
        read_info(tmp_path)


def test_a_flipped_bit_in_the_description_is_reported(tmp_path: Path) -> None:
    StitchFile.create(tmp_path / "one", info())
    path = tmp_path / "one" / SESSION
    assert read_info(tmp_path / "one") == info()
    path.write_text(path.read_text().replace("77", "76"))
    with pytest.raises(DecodeError, match="the file is damaged: found checksum"):
        read_info(tmp_path / "one")
    path.write_text(path.read_text().replace('"version": 2', '"version": 3'))
    with pytest.raises(DecodeError, match="found version 3, expected 2"):
        StitchFile.resume(tmp_path / "one")
