"""The commands on recordings through the real server: who may, what is answered, and that nothing else is touched."""

from __future__ import annotations

import asyncio
import io
import json
import tarfile
from pathlib import Path
from typing import Any

import pytest
from support.page_server import TOKEN, running
from support.recordings import recorded
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from tacshade_edge.dashboard import recording_commands


def socket(port: int, **words: Any) -> connect:
    return connect(f"ws://127.0.0.1:{port}/recordings", subprotocols=["tacshade-recordings"], compression=None, **words)


async def asked(port: int, command: object, **words: Any) -> tuple[dict[str, Any], bytes, list[str]]:
    """The first answer, all binary pieces, and what was said later."""
    async with socket(port, **words) as page:
        await page.send(command if isinstance(command, (str, bytes)) else json.dumps(command))
        first = json.loads(await page.recv())
        rest = [piece async for piece in page]
    return first, b"".join(p for p in rest if isinstance(p, bytes)), [p for p in rest if isinstance(p, str)]


async def test_a_list_a_download_and_a_deletion(tmp_path: Path) -> None:
    path = recorded(tmp_path, "run")
    for size in (0, 511, 512, 1 << 20):
        (path / f"{size:07}.png").write_bytes(bytes(size))

    async with running(recordings=tmp_path) as port:
        first, _, _ = await asked(port, {"action": "list"})
        assert [r["name"] for r in first["recordings"]] == ["run"]
        first, tar, _ = await asked(port, {"action": "download", "name": "run"})
        assert first == {"ok": True, "bytes": len(tar)}
        with tarfile.open(fileobj=io.BytesIO(tar)) as opened:
            assert {Path(name).name for name in opened.getnames()} == {file.name for file in path.iterdir()}
        assert (await asked(port, {"action": "delete", "name": "run"}))[0] == {"ok": True}
        assert not path.exists()
        assert (await asked(port, {"action": "list"}))[0]["recordings"] == []


@pytest.mark.parametrize(
    "command",
    [
        *("", "no JSON", "[]", "7", b"\xff", "[" * 5000),
        *({}, {"action": "rm"}, {"action": "delete"}, {"action": "delete", "name": "../run"}),
        *({"action": "download", "name": "/etc"}, {"action": "play", "name": "none"}, {"action": ["list"]}),
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


async def test_other_pages_strangers_and_a_server_without_a_folder_are_refused(tmp_path: Path) -> None:
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
    monkeypatch.setattr(recording_commands.sys, "executable", "/bin/cat")  # waits for nothing and complains
    (tmp_path / "sleeper").write_text('#!/bin/sh\necho "$@" > "$0.told"\necho out of order >&2\nexec sleep 60\n')
    (tmp_path / "sleeper").chmod(0o755)

    async with running(recordings=tmp_path) as port:
        first, _, later = await asked(port, {"action": "play", "name": "run"})
        assert first == {"ok": True, "sensor": "recording"}
        assert len(later) == 1
        assert "run: " in json.loads(later[0])["error"]
        monkeypatch.setattr(recording_commands.sys, "executable", str(tmp_path / "sleeper"))
        async with socket(port) as page:
            await page.send(json.dumps({"action": "play", "name": "run"}))
            assert json.loads(await page.recv())["ok"]
            told = tmp_path / "sleeper.told"
            while not told.exists() or not told.read_text():
                await asyncio.sleep(0.01)
            assert told.read_text().split()[2:5] == ["replay", str(tmp_path / "run"), "--play"]
            for action, error in (("play", "another recording"), ("delete", "is playing")):
                first, _, _ = await asked(port, {"action": action, "name": "run"})
                assert error in first["error"]
        while True:  # the replay ends, then it may be played again
            first, _, _ = await asked(port, {"action": "delete", "name": "run"})
            if first["ok"]:
                break
