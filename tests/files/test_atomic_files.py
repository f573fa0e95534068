from __future__ import annotations

import os
from pathlib import Path

import pytest
from support.synced_names import synced, unsynced

from tacshade_edge.errors import DeviceError
from tacshade_edge.files.atomic_files import (
    FolderLock,
    disk_errors,
    part,
    sync,
    write_set,
    write_whole,
)
from tacshade_edge.reasons import ReasonCode


@pytest.mark.parametrize("wait", [True, False])
def test_a_file_is_replaced_whole(tmp_path: Path, wait: bool) -> None:
    path = tmp_path / "a.json"
    for data in (b"one", b"two"):
        write_whole(path, data, sync=wait)
        assert path.read_bytes() == data
    sync(path)
    sync(tmp_path)
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_cannot_be_written_leaves_nothing_and_is_named(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with (
        pytest.raises(DeviceError, match=r"a.*: cannot write it: Is a directory"),
        disk_errors(tmp_path),
    ):
        write_whole(tmp_path / "a", b"data")  # written beside, and then not to be renamed
    assert not part(tmp_path / "a").exists()
    with (
        pytest.raises(DeviceError, match=r"none: cannot write it: No such file"),
        disk_errors(tmp_path),
    ):
        sync(tmp_path / "none")
    with (
        pytest.raises(DeviceError, match=rf"^{tmp_path}: cannot write it: no name"),
        disk_errors(tmp_path),
    ):
        raise OSError("no name")


def test_a_file_never_replaces_a_device_or_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/null")
    for name in ("pipe", "link"):
        with pytest.raises(OSError, match="found no regular file"):
            write_whole(tmp_path / name, b"data")
    assert (tmp_path / "pipe").is_fifo()
    assert (tmp_path / "link").is_char_device()
    for path in (Path("/"), Path()):
        with pytest.raises(IsADirectoryError):
            write_whole(path, b"data")


def test_a_folder_has_one_owner_and_says_who(tmp_path: Path) -> None:
    folder = tmp_path / "sessions"
    lock = FolderLock(folder, "sensor left")
    with pytest.raises(
        DeviceError, match=f"in use by 'sensor left, process {os.getpid()}'"
    ) as caught:
        FolderLock(folder, "sensor right")
    assert caught.value.code == ReasonCode.IN_USE
    lock.release()
    FolderLock(folder, "right").release()
    with pytest.raises(DeviceError, match="cannot write it"):
        FolderLock(Path("/proc/none"), "sensor left")


def test_one_file_alone_has_an_owner(tmp_path: Path) -> None:
    lock = FolderLock(tmp_path, "sensor left", file="a.npz")
    with pytest.raises(
        DeviceError, match=r"a\.npz: in use by .*, expected a file that no other program is using"
    ):
        FolderLock(tmp_path, "sensor right", file="a.npz")
    FolderLock(tmp_path, "sensor right", file="b.npz").release()
    FolderLock(tmp_path, "sensor right").release()
    lock.release()


def test_a_new_name_is_on_the_disk_before_the_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = synced(monkeypatch)
    write_whole(tmp_path / "a", b"one")
    write_set(tmp_path, {"b": b"two"}, "all.json", b"three")
    write_set(tmp_path, {"b": b"two"}, "all.json", b"three")
    assert unsynced(calls) == []
    write_whole(tmp_path / "a", b"one", sync=False)
    assert unsynced(calls) == [tmp_path]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "all.json", "b"]
