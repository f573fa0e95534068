"""The list of recordings: names that lead elsewhere, what a tar holds, what is deleted."""

from __future__ import annotations

import gc
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
from tacshade_edge.storage.recording.mcap_recorder import McapRecorder
from tacshade_edge.storage.recording.recorder import Recorder, png_of
from tacshade_edge.types import Frame
from tools.testbed.painted_sensor import FREE, painted_calibration


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


@pytest.mark.parametrize("kind", ["folder", "mcap"])
def test_one_that_is_being_written_is_left_alone_and_one_that_was_cut_off_is_not(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "run"
    recorder = Recorder(path, free_floor_bytes=0) if kind == "folder" else McapRecorder(path, "t", free_floor_bytes=0)
    recorder.begin("", painted_calibration())
    recorder.add(Frame(0, 1, 1, FREE), png_of(FREE))
    for each in (path, *path.iterdir()):  # no frame for a long time
        os.utime(each, (LONG_AGO_S, LONG_AGO_S))
    assert [r.is_growing for r in recordings.listed(tmp_path)] == [True]
    with pytest.raises(DeviceError, match="run is still being written"):
        recordings.find(tmp_path, "run")
    recorder.close()  # as the end of its process does
    assert [(r.is_growing, r.frames) for r in recordings.listed(tmp_path)] == [(False, None)]
    assert recordings.find(tmp_path, "run") == path


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


@pytest.mark.slow
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
    for size in (*range(513), 1 << 18, 10240 - 512):  # of the last block, and of what is sent at once
        (path / f"size-{size}").write_bytes(bytes([size % 256]) * size)
    pieces: list[bytes] = []
    recordings.tar(path, pieces.append)
    assert all(pieces)
    whole = b"".join(pieces)
    assert len(whole) == recordings.tar_bytes(path)
    with tarfile.open(fileobj=io.BytesIO(whole)) as tar:
        tar.extractall(tmp_path / "there", filter="data")
    there = tmp_path / "there/run"
    assert {p.name: p.read_bytes() for p in there.iterdir()} == {
        p.name: p.read_bytes() for p in path.iterdir() if p.is_file() and not p.is_symlink()
    }


def test_a_file_that_shrinks_meanwhile_is_an_error_and_not_a_wrong_tar(tmp_path: Path) -> None:
    path = recorded(tmp_path, "run")
    (path / "a.bin").write_bytes(bytes(1 << 22))
    pieces: list[bytes] = []

    def write(piece: bytes) -> None:
        pieces.append(piece)
        (path / "a.bin").write_bytes(b"")

    with pytest.raises(DeviceError, match=r"a\.bin cannot be read: unexpected end"):
        recordings.tar(path, write)
    before = len(pieces)
    gc.collect()
    assert len(pieces) == before


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
