"""The list of recordings: names that lead elsewhere, what a tar holds, what is deleted."""

from __future__ import annotations

import io
import os
import tarfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.recordings import LONG_AGO_S, recorded

from tacshade_edge.dashboard import recordings
from tacshade_edge.errors import DeviceError


def growing(folder: Path, name: str, changed_s: float | None = None) -> Path:
    path = folder / name
    path.mkdir()
    table = path / "frames.csv.part"
    table.write_text("image,t_ns\n")
    if changed_s is not None:
        for each in (table, path):
            os.utime(each, (changed_s, changed_s))
    return path


def test_the_newest_come_first_also_those_of_several_sensors(tmp_path: Path) -> None:
    recorded(tmp_path, "old", 1)
    recorded(tmp_path, "left-thumb/new", 3)
    recorded(tmp_path, "odd", 2, frames="many", bytes=-1)
    (tmp_path / "no-recording").mkdir()
    (tmp_path / "file").write_text("")
    (tmp_path / "linked").symlink_to(tmp_path / "old")
    found = recordings.listed(tmp_path)
    assert [(r.name, r.frames, r.size_bytes, r.is_growing) for r in found] == [
        ("left-thumb/new", 1, 600, False),
        ("odd", None, None, False),
        ("old", 1, 600, False),
    ]


def test_one_that_is_being_written_is_left_alone_and_one_that_was_cut_off_is_not(tmp_path: Path) -> None:
    growing(tmp_path, "now")
    growing(tmp_path, "cut-off", LONG_AGO_S)
    assert {r.name: r.is_growing for r in recordings.listed(tmp_path)} == {"now": True, "cut-off": False}
    with pytest.raises(DeviceError, match="now is still being written"):
        recordings.find(tmp_path, "now")
    assert recordings.find(tmp_path, "cut-off") == tmp_path / "cut-off"


@pytest.mark.parametrize(
    "name",
    [
        *("", ".", "..", "../outside", "sensor/../../outside", "/etc", "//etc", "sensor//run", "run/", "/run"),
        *("a/b/c", "..\\outside", "run\0", "run\n", ".hidden", "%2e%2e", "linked", "sensor/linked", "ｒｕｎ", "x" * 65),
        *(None, 7, ["run"], {"name": "run"}),
    ],
)
def test_a_name_never_leads_out_of_the_folder(tmp_path: Path, name: object) -> None:
    inside = tmp_path / "recordings"
    outside = recorded(tmp_path, "outside")
    recorded(inside, "run")
    recorded(inside, "sensor/run")
    for link in (inside / "linked", inside / "sensor/linked"):
        link.symlink_to(outside)
    with pytest.raises(DeviceError) as refused:
        recordings.find(inside, name)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 400
    assert recordings.find(inside, "sensor/run").is_dir()


@given(st.text())
def test_no_text_names_anything_else(name: str) -> None:
    here = Path(__file__).parent
    with pytest.raises(DeviceError):
        recordings.find(here, name)


def test_the_tar_is_what_tar_reads_without_links(tmp_path: Path) -> None:
    path = recorded(tmp_path, "run")
    (path / "secret").symlink_to("/etc/passwd")
    (path / "big.bin").write_bytes(bytes(range(256)) * 4096)
    os.mkfifo(path / "pipe")
    whole = b"".join(recordings.tar(path))
    assert len(whole) == recordings.tar_bytes(path)
    with tarfile.open(fileobj=io.BytesIO(whole)) as tar:
        tar.extractall(tmp_path / "there", filter="data")
    there = tmp_path / "there/run"
    assert {p.name: p.read_bytes() for p in there.iterdir()} == {
        name: (path / name).read_bytes() for name in ("000000.png", "frames.csv", "recording.json", "big.bin")
    }


def test_a_file_that_shrinks_meanwhile_is_an_error_and_not_a_wrong_tar(tmp_path: Path) -> None:
    path = recorded(tmp_path, "run")
    (path / "a.bin").write_bytes(bytes(1 << 20))
    pieces = recordings.tar(path)
    while len(next(pieces)) < 1000:
        pass
    (path / "a.bin").write_bytes(b"")
    with pytest.raises(DeviceError, match=r"a\.bin shrank"):
        list(pieces)


def test_deleting_follows_no_links_and_says_what_it_could_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outside = recorded(tmp_path, "outside")
    path = recorded(tmp_path / "in", "run")
    (path / "link").symlink_to(outside)
    recordings.delete(path)
    assert not path.exists()
    assert (outside / "frames.csv").is_file()

    def refuse(_path: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(recordings.shutil, "rmtree", refuse)
    with pytest.raises(DeviceError, match="outside cannot be deleted: Permission denied"):
        recordings.delete(outside)


def test_a_folder_that_is_gone_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="No such file"):
        recordings.listed(tmp_path / "none")
