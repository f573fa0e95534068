from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tacshade_edge.errors import DeviceError
from tacshade_edge.files import atomic_files
from tacshade_edge.files.atomic_files import disk_errors, part, write_whole
from tacshade_edge.files.targets import check_file, check_folder, one_at_a_time, owned_folder
from tacshade_edge.reasons import ReasonCode


def test_what_can_be_written_is_left_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    check_file(path)
    path.write_bytes(b"old")
    check_file(path)
    check_folder(tmp_path / "x" / "y", ["a.npz"])
    check_folder(tmp_path, ["a.npz"])
    assert [each.name for each in tmp_path.iterdir()] == ["a.npz"]
    assert path.read_bytes() == b"old"
    (tmp_path / "link").symlink_to("nowhere")
    check_file(tmp_path / "link")
    (tmp_path / "link").unlink()


def test_what_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "old.part").mkdir()
    (tmp_path / "link").symlink_to("none/a")
    for path, said in (
        (tmp_path, "Is a directory"),
        (Path("/"), "Is a directory"),
        (tmp_path / "file/a", "Not a directory"),
        (tmp_path / "none/a", "No such file or directory"),
        (tmp_path / "link", "No such file or directory"),
        (tmp_path / "pipe", "found no regular file"),
        (tmp_path / "old", "Is a directory"),
        (tmp_path / ("a" * 252), "File name too long"),
    ):
        with pytest.raises(DeviceError, match=f"cannot write it: {said}") as caught:
            check_file(path)
        assert caught.value.code == ReasonCode.DISK
    for folder in (tmp_path / "file", tmp_path / "file/a", Path("/proc/none")):
        with pytest.raises(DeviceError, match="cannot write it"):
            check_folder(folder)
    with pytest.raises(DeviceError, match="pipe: cannot write it: found no regular file"):
        check_folder(tmp_path, ["a", "pipe"])


def test_a_full_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tacshade_edge.files.targets.WORK_FLOOR_BYTES", 2**62)
    for check in (check_file, check_folder):
        with pytest.raises(DeviceError, match=r"MiB free on the disk, expected at least") as caught:
            check(tmp_path / "a")
        assert caught.value.code == ReasonCode.DISK_FULL


def test_one_writes_and_another_reads_who_it_is(tmp_path: Path) -> None:
    path = tmp_path / "cal.npz"
    with one_at_a_time(path, "calibrate", "fitting into"):
        said = rf"^another calibrate \(pid {os.getpid()}\) is fitting into {re.escape(str(path))}"
        for _ in range(2):
            with (
                pytest.raises(DeviceError, match=rf"{said} since \d\d:\d\d; wait") as caught,
                one_at_a_time(path, "calibrate", "writing"),
            ):
                pass
            assert caught.value.code == ReasonCode.IN_USE
        with one_at_a_time(tmp_path / "other.npz", "calibrate", "writing"):
            pass
        (tmp_path / "link").symlink_to(path)
        with (
            pytest.raises(DeviceError, match=said),
            one_at_a_time(tmp_path / "link", "calibrate", "writing"),
        ):
            pass
        (tmp_path / "link").unlink()
    assert not list(tmp_path.iterdir())
    with one_at_a_time(tmp_path, "capture", "filling"):  # of a folder it lies inside
        assert len(list(tmp_path.iterdir())) == 1
    assert not list(tmp_path.iterdir())
    with (
        pytest.raises(DeviceError, match="cannot write it"),
        one_at_a_time(tmp_path / "none/a", "calibrate", "writing"),
    ):
        pass


def test_a_folder_has_one_owner_and_is_gone_if_nothing_was_put_in(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    with owned_folder(folder, "stitch"):
        with (
            pytest.raises(DeviceError, match=r"another stitch \(pid \d+\) is writing"),
            owned_folder(folder, "stitch"),
        ):
            pass
        assert folder.is_dir()
    assert not list(tmp_path.iterdir())
    with owned_folder(folder, "stitch"):
        (folder / "map.json").touch()
    assert [path.name for path in folder.iterdir()] == ["map.json"]
    with pytest.raises(ZeroDivisionError), owned_folder(folder, "stitch"):
        raise ZeroDivisionError
    assert [path.name for path in folder.iterdir()] == ["map.json"]


HOLDER = """
import sys, time
from pathlib import Path
from tacshade_edge.files.targets import one_at_a_time
with one_at_a_time(Path(sys.argv[1]), "teach", "changing"):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.mark.slow
def test_an_owner_that_was_killed_keeps_nobody_away(tmp_path: Path) -> None:
    path = tmp_path / "objects.npz"
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(path)], stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with (
            pytest.raises(DeviceError, match=rf"another teach \(pid {holder.pid}\) is changing"),
            one_at_a_time(path, "teach", "changing"),
        ):
            pass
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        with one_at_a_time(path, "teach", "changing"):
            pass
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_of_many_at_once_one_is_in(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    """Each adds 1 to a file between its reading and its writing; none may be lost."""
    text = """
import sys
from pathlib import Path
from tacshade_edge.errors import DeviceError
from tacshade_edge.files import atomic_files
from tacshade_edge.files.atomic_files import disk_errors, part, write_whole
from tacshade_edge.files.targets import one_at_a_time
path, done = Path(sys.argv[1]), 0
while done < 100:
    try:
        with one_at_a_time(path, "teach", "changing"):
            path.write_text(str(int(path.read_text()) + 1))
            done += 1
    except DeviceError:
        pass
"""
    path = tmp_path / "count"
    path.write_text("0")
    made = [subprocess.Popen([sys.executable, "-c", text, str(path)]) for _ in range(4)]
    assert [each.wait() for each in made] == [0] * 4
    assert path.read_text() == "400"
    record_property("tried", 400)


WRITER = """
import sys
from pathlib import Path
from tacshade_edge.files.atomic_files import write_whole
path, letter = Path(sys.argv[1]), sys.argv[2].encode()
for _ in range(100):
    write_whole(path, (letter * 5000 for _ in range(20)), sync=False)
"""
STUCK = """
import sys, time
from pathlib import Path
from tacshade_edge.files.atomic_files import write_whole
def data():
    yield b"half" * 5000
    print("half", flush=True)
    time.sleep(600)
write_whole(Path(sys.argv[1]), data())
"""


@pytest.mark.slow
def test_two_that_write_one_file_at_once_write_it_whole(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    path, whole = tmp_path / "a.npz", [letter * 100_000 for letter in (b"a", b"b", b"c")]
    path.write_bytes(whole[0])
    words = [sys.executable, "-c", WRITER, str(path)]
    made = [subprocess.Popen([*words, letter]) for letter in "bc"]
    while any(each.poll() is None for each in made):
        assert path.read_bytes() in whole
    assert [each.returncode for each in made] == [0, 0]
    assert path.read_bytes() in whole[1:]
    assert list(tmp_path.iterdir()) == [path]
    record_property("tried", 200)


@pytest.mark.slow
def test_who_is_stuck_in_a_file_keeps_others_out_until_it_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(atomic_files, "WAIT_S", 0.05)
    path = tmp_path / "a.npz"
    path.write_bytes(b"old")
    with subprocess.Popen(
        [sys.executable, "-c", STUCK, str(path)], stdout=subprocess.PIPE, text=True
    ) as stuck:
        assert stuck.stdout is not None
        assert stuck.stdout.readline() == "half\n"
        with (
            pytest.raises(DeviceError, match=r"part: cannot write it: another program has been"),
            disk_errors(tmp_path),
        ):
            write_whole(path, b"new")
        assert path.read_bytes() == b"old"
        stuck.send_signal(signal.SIGKILL)
    assert part(path).exists()
    write_whole(path, b"new")
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]
