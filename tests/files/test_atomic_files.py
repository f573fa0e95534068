from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.synced_names import synced, unsynced
from tacshade_edge.errors import DeviceError
from tacshade_edge.files.atomic_files import (
    FolderLock,
    disk_errors,
    free_name,
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


def test_a_link_stays_and_its_target_is_written(tmp_path: Path) -> None:
    for name in ("versions", "used"):
        (tmp_path / name).mkdir()
    link, target = tmp_path / "used" / "current", tmp_path / "versions" / "1"
    link.symlink_to("../versions/1")
    for data in (b"one", b"two"):  # at first it names nothing
        write_whole(link, data)
        assert link.is_symlink()
        assert target.read_bytes() == data
    assert [path.name for path in tmp_path.rglob("*") if path.is_file() and path != link] == ["1"]
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(OSError, match="symbolic links"):
        write_whole(tmp_path / "loop", b"data")


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 0o777), st.booleans())
def test_what_is_replaced_keeps_its_mode_and_owner(mode: int, linked: bool) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a"
        path.write_bytes(b"one")
        path.chmod(mode)
        if os.geteuid() == 0:
            os.chown(path, 1234, 4321)
        before = path.stat()
        given_path = Path(folder) / "b" if linked else path
        if linked:
            given_path.symlink_to("a")
        write_whole(given_path, b"two", sync=False)
        after = path.stat()
        assert after.st_ino != before.st_ino
        kept = ("st_mode", "st_uid", "st_gid")
        assert [getattr(after, key) for key in kept] == [getattr(before, key) for key in kept]


def test_a_file_that_is_a_mount_says_so_in_a_line(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).write_text(name)
    script = (
        "import sys; from pathlib import Path; from tacshade_edge.files.atomic_files import *\n"
        "try:\n    with disk_errors(Path('.')): write_whole(Path('b'), b'c')\n"
        "except Exception as error: print(type(error).__name__, error)"
    )
    inner = f'mount --bind a b && {shlex.quote(sys.executable)} -c "$0"'
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", inner, script],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    if "DeviceError" not in done.stdout:
        pytest.skip(f"no mounts here: {done.stderr}")
    assert done.stdout == (
        "DeviceError b: cannot write it: the file itself is a mount and cannot be replaced; mount "
        "the folder that contains it instead\n"
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_a_name_by_the_second_that_exists_gets_a_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("time.gmtime", lambda: time.struct_time((1970, 1, 1, 0, 0, 9, 3, 1, 0)))
    names = []
    for _ in range(3):
        free_name(tmp_path).mkdir()
        names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["19700101-000009", "19700101-000009-2", "19700101-000009-3"]
