"""Recordings: hostile names, what a tar holds, what is deleted;
and the commands through the real server.
"""

from __future__ import annotations

import asyncio
import io
import json
import os
import tarfile
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from support.page_server import TOKEN, get, running
from support.painted_sensor import FREE, painted_calibration
from support.recordings import LONG_AGO_S, recorded
from tacshade_edge.calibration.files.calibration_file import packed
from tacshade_edge.dashboard import recordings
from tacshade_edge.dashboard.recording_tar import CHUNK_BYTES, tar_of
from tacshade_edge.errors import DeviceError
from tacshade_edge.recording.recorder import RecordingWriter, png_of
from tacshade_edge.types import Frame


def test_the_newest_come_first_also_those_of_several_sensors(tmp_path: Path) -> None:
    recorded(tmp_path, "old", 1)
    recorded(tmp_path, "left-thumb/new", 3)
    recorded(tmp_path, "odd", 2, frames="many", bytes=-1)
    (tmp_path / "no-recording").mkdir()
    (tmp_path / "file").write_text("")
    (tmp_path / "linked").symlink_to(tmp_path / "old")
    found = recordings.listed(tmp_path)
    assert [
        tuple(r[key] for key in ("name", "frames", "size_bytes", "is_growing")) for r in found
    ] == [
        ("left-thumb/new", 1, 600, False),
        ("odd", None, None, False),
        ("old", 1, 600, False),
    ]


def test_one_that_is_being_written_is_left_alone_and_one_that_was_cut_off_is_not(
    tmp_path: Path,
) -> None:
    path = tmp_path / "run"
    recorder = RecordingWriter(path)
    recorder.begin("", packed(painted_calibration()))
    recorder.add(Frame(0, 1, 1, FREE), png_of(FREE))
    for each in (path, *path.iterdir()):  # no frame for a long time
        os.utime(each, (LONG_AGO_S, LONG_AGO_S))
    assert [r["is_growing"] for r in recordings.listed(tmp_path)] == [True]
    with pytest.raises(DeviceError, match="run is still being written"):
        recordings.find(tmp_path, "run")
    recorder.close()  # as the end of its process does
    assert [(r["is_growing"], r["frames"]) for r in recordings.listed(tmp_path)] == [(False, None)]
    assert recordings.find(tmp_path, "run") == path


@pytest.mark.parametrize(
    "name",
    [
        "",
        ".",
        "..",
        "../outside",
        "sensor/../../outside",
        "/etc",
        "//etc",
        "sensor//run",
        "run/",
        "/run",
        "a/b/c",
        "..\\outside",
        "run\0",
        "run\n",
        ".hidden",
        "%2e%2e",
        "linked",
        "sensor/linked",
        "ｒｕｎ",
        "x" * 65,
        None,
        7,
        ["run"],
        {"name": "run"},
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


def test_the_tar_is_what_tar_reads_without_links(tmp_path: Path) -> None:
    path = recorded(tmp_path, "run")
    (path / "secret").symlink_to("/etc/passwd")
    (path / "big.bin").write_bytes(bytes(range(256)) * 4096)
    os.mkfifo(path / "pipe")
    for size in (
        *range(513),
        1 << 18,
        10240 - 512,
    ):  # of the last block, and of what is sent at once
        (path / f"size-{size}").write_bytes(bytes([size % 256]) * size)
    tar = tar_of(path)
    pieces = list(tar.pieces())
    assert all(pieces)
    whole = b"".join(pieces)
    assert len(whole) == tar.size_bytes
    for start, stop in ((0, 1), (511, 513), (5000, 700_000), (len(whole) - 1, len(whole))):
        assert b"".join(tar.pieces(start, stop)) == whole[start:stop]
    with tarfile.open(fileobj=io.BytesIO(whole)) as opened:
        opened.extractall(tmp_path / "there", filter="data")
    there = tmp_path / "there/run"
    assert {p.name: p.read_bytes() for p in there.iterdir()} == {
        p.name: p.read_bytes() for p in path.iterdir() if p.is_file() and not p.is_symlink()
    }


def test_a_file_that_shrinks_meanwhile_is_an_error_and_not_a_wrong_tar(tmp_path: Path) -> None:
    path = recorded(tmp_path, "run")
    (path / "a.bin").write_bytes(bytes(1 << 22))
    pieces = tar_of(path).pieces()
    while len(next(pieces)) < CHUNK_BYTES:
        pass
    (path / "a.bin").write_bytes(b"")
    with pytest.raises(DeviceError, match=r"a\.bin cannot be read: unexpected end"):
        next(pieces)
    assert list(pieces) == []


def test_deleting_follows_no_links(tmp_path: Path) -> None:
    outside = recorded(tmp_path, "outside")
    path = recorded(tmp_path / "in", "run")
    (path / "link").symlink_to(outside)
    recordings.delete(path)
    assert not path.exists()
    assert (outside / "frames.csv").is_file()
    with pytest.raises(DeviceError, match="run cannot be deleted: No such file"):
        recordings.delete(path)


def socket(port: int, **words: Any) -> connect:
    return connect(
        f"ws://127.0.0.1:{port}/recordings",
        subprotocols=["tacshade-recordings"],
        compression=None,
        **words,
    )


async def asked(
    port: int, command: object, **words: Any
) -> tuple[dict[str, Any], bytes, list[str]]:
    """The first answer, all binary pieces, and what was said later."""
    async with socket(port, **words) as page:
        await page.send(command if isinstance(command, (str, bytes)) else json.dumps(command))
        first = json.loads(await page.recv())
        rest = [piece async for piece in page]
    return (
        first,
        b"".join(p for p in rest if isinstance(p, bytes)),
        [p for p in rest if isinstance(p, str)],
    )


async def test_a_list_a_download_and_a_deletion(tmp_path: Path) -> None:
    path = recorded(tmp_path, "run")
    for size in (0, 511, 512, 1 << 20):
        (path / f"{size:07}.png").write_bytes(bytes(size))

    async with running(recordings=tmp_path) as port:
        first, _, _ = await asked(port, {"action": "list"})
        assert [r["name"] for r in first["recordings"]] == ["run"]
        status, _, tar = await get(port, "/recordings/run.tar")
        assert status == 200
        with tarfile.open(fileobj=io.BytesIO(tar)) as opened:
            assert {Path(name).name for name in opened.getnames()} == {
                file.name for file in path.iterdir()
            }
        assert (await asked(port, {"action": "delete", "name": "run"}))[0] == {"ok": True}
        assert not path.exists()
        assert (await asked(port, {"action": "list"}))[0]["recordings"] == []


@pytest.mark.parametrize(
    "command",
    [
        "",
        "[]",
        b"\xff",
        "[" * 5000,
        {"action": ["list"]},
        {"action": "delete"},
        {"action": "delete", "name": "../run"},
        {"action": "play", "name": "none"},
    ],
)
async def test_nonsense_and_hostile_names_get_one_line(tmp_path: Path, command: object) -> None:
    recorded(tmp_path, "run")
    (tmp_path / "in").mkdir()

    async with running(recordings=tmp_path / "in") as port:
        first, data, later = await asked(port, command)
        assert first["ok"] is False
        assert first["error"]
        assert "\n" not in first["error"]
        assert (data, later) == (b"", [])
        assert (tmp_path / "run/frames.csv").is_file()


async def test_a_page_that_may_only_look_deletes_and_plays_nothing(tmp_path: Path) -> None:
    path = recorded(tmp_path, "run")

    async with running(recordings=tmp_path, read_only=True) as port:
        for action in ("delete", "play"):
            first, _, _ = await asked(port, {"action": action, "name": "run"})
            assert first == {"ok": False, "error": "read-only: this dashboard forwards no requests"}
        assert path.is_dir()
        assert (await asked(port, {"action": "list"}))[0]["ok"]


async def test_other_pages_strangers_and_a_server_without_a_folder_are_refused(
    tmp_path: Path,
) -> None:
    recorded(tmp_path, "run")

    async with running(recordings=tmp_path, token=TOKEN) as port:
        with pytest.raises(InvalidStatus) as refused:
            await asked(port, {"action": "delete", "name": "run"})
        assert refused.value.response.status_code == 401
        known = {"Authorization": f"Bearer {TOKEN}"}
        words: dict[str, Any] = {"origin": "http://evil.example", "additional_headers": known}
        with pytest.raises(InvalidStatus) as refused:
            await asked(port, {"action": "list"}, **words)
        assert refused.value.response.status_code == 403
    async with running() as port:
        first, _, _ = await asked(port, {"action": "list"})
        assert "without --recordings" in first["error"]
    assert (tmp_path / "run").is_dir()


@pytest.mark.slow
async def test_one_recording_at_a_time_is_played_and_ends_with_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded(tmp_path, "run")
    monkeypatch.setattr(recordings.sys, "executable", "/bin/cat")  # waits for nothing and complains
    (tmp_path / "sleeper").write_text(
        '#!/bin/sh\necho "$@" > "$0.words"\necho out of order >&2\nexec sleep 60\n'
    )
    (tmp_path / "sleeper").chmod(0o755)

    async with running(recordings=tmp_path) as port:
        first, _, later = await asked(port, {"action": "play", "name": "run"})
        assert first == {"ok": True, "sensor": "recording"}
        assert len(later) == 1
        assert "run: " in json.loads(later[0])["error"]
        monkeypatch.setattr(recordings.sys, "executable", str(tmp_path / "sleeper"))
        async with socket(port) as page:
            await page.send(json.dumps({"action": "play", "name": "run"}))
            assert json.loads(await page.recv())["ok"]
            words = tmp_path / "sleeper.words"
            while not words.exists() or not words.read_text():
                await asyncio.sleep(0.01)
            assert words.read_text().split()[2:5] == ["replay", str(tmp_path / "run"), "--play"]
            for action, error in (("play", "another recording"), ("delete", "is playing")):
                first, _, _ = await asked(port, {"action": action, "name": "run"})
                assert error in first["error"]
        while True:  # the replay ends, then it may be played again
            first, _, _ = await asked(port, {"action": "delete", "name": "run"})
            if first["ok"]:
                break
