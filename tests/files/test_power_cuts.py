"""The power is cut at each sync of each file that the program promises to keep: the old content or
the new one is there, whole, and the new one once the call has returned.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from support.bumpy_surface import grid_poses, press_of
from support.forgetting_disk import ForgettingDisk, PowerCutError, Way
from support.kept_files import FRAMES, KEPT, NEW, OLD
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.recording.recorder import RecordingWriter, png_of
from tacshade_edge.recording.recording import Recording
from tacshade_edge.stitching.stitch_file import SessionInfo, StitchFile

pytestmark = pytest.mark.slow
SYNCS_MAX = 100
Stated = Callable[[str, object], None]


@contextmanager
def disk_of(folder: Path, number: int) -> Iterator[ForgettingDisk]:
    """A folder's disk, which forgets from its n-th sync on."""
    with pytest.MonkeyPatch.context() as patch, ForgettingDisk(folder, patch, number) as disk:
        yield disk


@pytest.mark.parametrize("name", KEPT)
def test_a_file_is_old_or_new(name: str, tmp_path: Path, record_property: Stated) -> None:
    kept, number = KEPT[name], 0
    (tmp_path / OLD).mkdir()
    kept.write(tmp_path / OLD, OLD)
    for number in range(1, SYNCS_MAX):
        folder = tmp_path / str(number)
        shutil.copytree(tmp_path / OLD, folder)
        with disk_of(folder, number) as disk, suppress(PowerCutError):
            kept.write(folder, NEW)
        for way in get_args(Way):
            after = disk.after(tmp_path / f"{number}-{way}", way)
            found = kept.read(after)
            allowed = {OLD, NEW} | kept.news(after) if disk.cut else {NEW}
            assert found in allowed, (number, way)
            if found != NEW:
                kept.write(after, NEW)
                assert kept.read(after) == NEW, (number, way)
        if not disk.cut:
            break
    record_property("tried", len(get_args(Way)) * (number - 1))
    assert not disk.cut


def test_a_recording_keeps_what_was_synced(tmp_path: Path, record_property: Stated) -> None:
    number = 0
    for number in range(1, SYNCS_MAX):
        folder, synced = tmp_path / str(number) / "r", 0
        folder.parent.mkdir()
        with disk_of(folder.parent, number) as disk:
            writer: Any = None
            with suppress(PowerCutError):
                writer = RecordingWriter(folder)
                writer.begin("sensor_id: left\n", b"a calibration")
                for each in FRAMES:
                    writer.add(each, png_of(each.image))
                    writer.sync()
                    synced += 1
                writer.finish({})
            if writer is not None:
                writer.close()
        for way in get_args(Way):
            after = disk.after(tmp_path / f"{number}-{way}", way) / "r"
            found = read_frames(after)
            assert len(found) >= synced, (number, way)
            for seq, image in found:
                np.testing.assert_array_equal(image, FRAMES[seq].image)
        if not disk.cut:
            break
    record_property("tried", len(get_args(Way)) * (number - 1))
    assert not disk.cut
    assert synced == len(FRAMES)


def read_frames(folder: Path) -> list[tuple[int, Any]]:
    """The frames that a recording still has; none where it never began."""
    try:
        recording = Recording(folder)
    except ConfigError:
        return []
    found = []
    for entry in iter(recording.next_entry, None):
        # The table may name a picture whose name is not on the disk: a replay reports it.
        with suppress(DecodeError):
            found.append((entry.seq, entry.picture()))
    return found


def test_a_session_keeps_the_presses_that_it_took(tmp_path: Path, record_property: Stated) -> None:
    poses = grid_poses()[:3]
    points = [press_of(pose, k) for k, pose in enumerate(poses)]
    number = 0
    for number in range(1, SYNCS_MAX):
        folder, taken = tmp_path / str(number) / "one", 0
        folder.parent.mkdir()
        with disk_of(folder.parent, number) as disk, suppress(PowerCutError):
            file = StitchFile.create(folder, SessionInfo("one", 5, 77, 20.0))
            with closing(file):
                for each, pose in zip(points, poses, strict=True):
                    file.append(each, pose)
                    taken += 1
                file.end()
        for way in get_args(Way):
            after = disk.after(tmp_path / f"{number}-{way}", way) / "one"
            if taken or (after / "session.json").exists():
                found = StitchFile.resume(after)[1]
                assert taken <= len(found) <= taken + 1, (number, way)
                for (one, _), true in zip(found, points, strict=False):
                    np.testing.assert_array_equal(one.points_mm, true.points_mm)
        if not disk.cut:
            break
    record_property("tried", len(get_args(Way)) * (number - 1))
    assert not disk.cut
    assert taken == len(points)
