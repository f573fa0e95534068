"""Each system call of each file that the program promises to keep fails in turn: the old content or
the new one is there, whole; the error is one line; and the next try succeeds.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from support.bumpy_surface import grid_poses, press_of
from support.failing_disk import FailingDisk, Way
from support.kept_files import FRAMES, KEPT, NEW, OLD
from tacshade_edge.errors import DeviceError
from tacshade_edge.recording.recorder import RecordingWriter, png_of
from tacshade_edge.recording.recording import Recording
from tacshade_edge.stitching.stitch_file import SessionInfo, StitchFile

pytestmark = pytest.mark.slow
CALLS_MAX = 200
Stated = Callable[[str, object], None]


def failing(
    folder: Path, number: int, way: Way, work: Callable[[], object]
) -> tuple[FailingDisk, DeviceError | None]:
    """Do something on a disk that fails at a call; return the disk and the error."""
    found: DeviceError | None = None
    with pytest.MonkeyPatch.context() as patch:
        disk = FailingDisk(folder, patch, number, way)
        try:
            work()
        except DeviceError as error:
            found = error
    said = str(found)
    assert found is None or ("cannot write" in said and "\n" not in said), said
    return disk, found


@pytest.fixture(autouse=True)
def no_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    """To wait for the disk would take most of the time; whether that fails is what counts."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


@pytest.mark.parametrize("way", get_args(Way))
@pytest.mark.parametrize("name", KEPT)
def test_a_file_is_old_or_new(name: str, way: Way, tmp_path: Path, record_property: Stated) -> None:
    kept, is_over = KEPT[name], False
    (tmp_path / OLD).mkdir()
    kept.write(tmp_path / OLD, OLD)
    for number in range(1, CALLS_MAX):
        folder = tmp_path / str(number)
        shutil.copytree(tmp_path / OLD, folder)
        disk, error = failing(folder, number, way, lambda: kept.write(folder, NEW))  # noqa: B023
        found = kept.read(folder)
        if error is None:
            assert found == NEW
        assert found in {OLD, NEW} | kept.news(folder), (number, str(error))
        if is_over := not disk.failed:
            break
        if found != NEW:
            kept.write(folder, NEW)
            assert kept.read(folder) == NEW, number
    record_property("tried", number - 1)
    assert is_over
    assert number > 3


@pytest.mark.parametrize("way", get_args(Way))
def test_a_recording_keeps_the_frames_that_it_took(
    way: Way, tmp_path: Path, record_property: Stated
) -> None:
    for number in range(1, CALLS_MAX):
        folder, taken = tmp_path / str(number), 0

        def record() -> None:
            nonlocal taken
            writer = RecordingWriter(folder)  # noqa: B023
            try:
                writer.begin("sensor_id: left\n", b"a calibration")
                for each in FRAMES:
                    writer.event(each.t_ns, "mark", {})
                    taken += writer.add(each, png_of(each.image))
                writer.finish({})
            finally:
                with suppress(OSError):
                    writer.close()

        disk, error = failing(tmp_path, number, way, record)
        if taken:
            recording = Recording(folder)
            found = list(iter(recording.next_entry, None))
            assert taken <= len(found) <= taken + 1, (number, str(error))
            for entry in found:
                np.testing.assert_array_equal(entry.picture(), FRAMES[entry.seq].image)
        if not disk.failed:
            break
    record_property("tried", number - 1)
    assert not disk.failed
    assert number > 20


@pytest.mark.parametrize("way", get_args(Way))
def test_a_session_keeps_the_presses_that_it_took(
    way: Way, tmp_path: Path, record_property: Stated
) -> None:
    poses = grid_poses()[:3]
    points = [press_of(pose, k) for k, pose in enumerate(poses)]
    for number in range(1, CALLS_MAX):
        folder, taken = tmp_path / str(number), 0

        def press() -> None:
            nonlocal taken
            file = StitchFile.create(folder, SessionInfo("one", 5, 77, 20.0))  # noqa: B023
            with closing(file):
                for each, pose in zip(points, poses, strict=True):
                    file.append(each, pose)
                    taken += 1
                file.end()

        disk, _ = failing(tmp_path, number, way, press)
        if (folder / "session.json").exists():
            file, found = StitchFile.resume(folder)
            assert taken <= len(found) <= taken + 1, number
            for (one, _), true in zip(found, points, strict=False):
                np.testing.assert_array_equal(one.points_mm, true.points_mm)
            file.append(points[0], poses[0])
            file.close()
            same = StitchFile.resume(folder)[1]
            assert len(same) == len(found) + 1
        if not disk.failed:
            break
    record_property("tried", number - 1)
    assert not disk.failed
    assert number > 8
