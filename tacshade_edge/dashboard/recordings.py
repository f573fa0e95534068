"""A page's commands on the recordings in one folder;
names come from the page, so they are untrusted.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import json
import logging
import os
import re
import shutil
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Final

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request

from tacshade_edge.dashboard.downloads import ASKED, Downloads
from tacshade_edge.dashboard.recording_tar import errors
from tacshade_edge.dashboard.relay import STALL_S, Broker
from tacshade_edge.errors import DeviceError
from tacshade_edge.quoting import escaped, shown
from tacshade_edge.regular_files import read_regular
from tacshade_edge.wire.requests import RECORD_NAME

_log = logging.getLogger(__name__)

PLAYED_AS: Final = "recording"
"""Sensor ID of a played recording on the broker."""
_ASK_S: Final = 5.0
_END_S: Final = 3.0
_READ_ONLY: Final = ("list",)
_PARTS_MAX: Final = 2  # SENSOR/NAME with several sensors
LISTED_MAX: Final = 200
# A folder with more names is no folder of recordings; to look at each would block the server.
_LOOKED_AT_MAX: Final = 2000
_ABOUT: Final = "recording.json"
_SIGNS: Final = (_ABOUT, "frames.csv", "frames.csv.part", "000.mcap", "000.mcap.part")
_LOCKED: Final = ("events.jsonl.part", "events.jsonl")
"""The recorder holds a lock on its events until the recording is whole,
however long no frame comes.
"""
_ABOUT_BYTES_MAX: Final = 1 << 20
_NAME: Final = re.compile(RECORD_NAME)


Listed = dict[str, Any]
"""One recording in the list: `name` for `find`, ``NAME``, or ``SENSOR/NAME`` with several sensors;
`frames` and `size_bytes`, None until its writer has finished it; `began_ns`, the Unix time of its
first frame, or else of its last change; `is_growing`.
"""


def listed(folder: Path) -> list[Listed]:
    """List the recordings in a folder and its subfolders, newest first, at most `LISTED_MAX`.

    Raises DeviceError.
    """
    names = []
    for name in _names(folder):
        inside = (
            [name]
            if _is_recording(folder / name)
            else [f"{name}/{inner}" for inner in _names(folder / name)]
        )
        names += [each for each in inside if _is_recording(folder / each)]
    return sorted((_look_at(folder, name) for name in names), key=lambda one: -one["began_ns"])[
        :LISTED_MAX
    ]


def find(folder: Path, name: object) -> Path:
    """Return the path of a whole recording in the folder.

    Raises DeviceError for any other name and for links.
    """
    parts = name.split("/") if isinstance(name, str) else []
    if not 1 <= len(parts) <= _PARTS_MAX or not all(_NAME.match(part) for part in parts):
        raise DeviceError(
            f"found the name {shown(str(name))}, expected the name of a listed recording"
        )
    path = folder
    for part in parts:
        path /= part
        # A link could lead out of the folder, to any file that this user may read or delete.
        if path.is_symlink():
            raise DeviceError(
                f"{shown(str(name))}: found a symbolic link, expected a recording's file or folder"
            )
    # Only what looks like a recording: a page must not delete or fetch another folder.
    if not _is_recording(path):
        raise DeviceError(f"found no recording {shown(str(name))}")
    if _look_at(folder, "/".join(parts))["is_growing"]:
        raise DeviceError(f"{shown(str(name))} is still being written")
    return path


def delete(path: Path) -> None:
    """Delete a recording that `find` returned.

    Raises DeviceError; some files may already be deleted.
    """
    with errors(f"{path.name} cannot be deleted"):
        shutil.rmtree(path)


def _names(folder: Path) -> list[str]:
    """Return the subfolders with a valid name of a recording, without links."""
    with errors(str(folder)), os.scandir(folder) as entries:
        found = [
            entry.name
            for entry in entries
            if _NAME.match(entry.name) and entry.is_dir(follow_symlinks=False)
        ]
    return sorted(found, reverse=True)[:_LOOKED_AT_MAX]


def _is_recording(path: Path) -> bool:
    return any((path / sign).is_file() for sign in _SIGNS)


def _look_at(folder: Path, name: str) -> Listed:
    path = folder / name
    try:
        changed_s = max(
            (path / sign).stat().st_mtime for sign in ("", *_SIGNS) if (path / sign).exists()
        )
    except (OSError, ValueError):
        changed_s = 0.0  # deleted in the meantime
    try:
        about = json.loads(read_regular(path / _ABOUT, _ABOUT_BYTES_MAX))
    except (OSError, ValueError, RecursionError):
        about = None
    first_ns, frames, size = (
        _count(about.get(key)) if isinstance(about, dict) else None
        for key in ("first_wall_ns", "frames", "bytes")
    )
    is_growing = not (path / _ABOUT).is_file() and any(_is_locked(path / name) for name in _LOCKED)
    began_ns = first_ns or int(changed_s * 1e9)
    return {
        "name": name,
        "frames": frames,
        "size_bytes": size,
        "began_ns": began_ns,
        "is_growing": is_growing,
    }


def _is_locked(path: Path) -> bool:
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(descriptor)
    return False


def _count(value: object) -> int | None:
    return value if isinstance(value, int) and 0 <= value < 1 << 63 else None


# -- the commands ----------------------------------------------------------------------------------


class RecordingCommands:
    """The commands of pages on one folder, which may be missing;
    one recording plays at a time, to `broker`.
    """

    def __init__(
        self, folder: Path | None, broker: Broker, downloads: Downloads, *, read_only: bool
    ) -> None:
        self._folder = folder
        self._broker = broker
        self._downloads = downloads
        self._read_only = read_only
        self._played = ""
        self._player = asyncio.Lock()

    async def serve(self, page: ServerConnection) -> None:
        """Answer one command; ``error`` describes a failure in one line."""
        with contextlib.suppress(ConnectionClosed, TimeoutError):
            try:
                async with asyncio.timeout(_ASK_S):
                    command = _command(await page.recv())
                await self._do(page, command.get("action"), command.get("name"))
            except DeviceError as error:
                _log.info("rejected a page's recording command: %s", escaped(str(error)))
                await _answer(page, ok=False, error=str(error))

    async def _do(self, page: ServerConnection, action: object, name: object) -> None:
        folder = self._folder
        if folder is None:
            raise DeviceError(
                "this dashboard lists no recordings: it was started without --recordings"
            )
        if self._read_only and action not in _READ_ONLY:
            raise DeviceError("read-only: this dashboard forwards no requests")
        if action == "list":
            await _answer(page, ok=True, recordings=await asyncio.to_thread(listed, folder))
        elif action == "delete":
            path = await asyncio.to_thread(find, folder, name)
            if self._played == str(path):
                raise DeviceError(f"{shown(str(name))} is playing")
            await asyncio.to_thread(delete, path)
            _log.info("a page deleted the recording %s", path)
            await _answer(page, ok=True)
        elif action == "play":
            await self._play(page, await asyncio.to_thread(find, folder, name))
        else:
            raise DeviceError("found an unknown action, expected list, delete or play")

    async def download(self, page: ServerConnection, request: Request, name: str) -> None:
        """Answer an HTTP request for a recording's tar.

        Raises DeviceError before anything is sent.
        """
        if self._folder is None:
            raise DeviceError("this dashboard lists no recordings")
        with self._downloads.place():
            tar = await self._downloads.tar(await asyncio.to_thread(find, self._folder, name))
            body = getattr(request, "method", "GET") != "HEAD"
            asked = {key: request.headers[key] for key in ASKED if key in request.headers}
            await self._downloads.answer(page, tar, asked, body=body)

    async def _play(self, page: ServerConnection, path: Path) -> None:
        """Play a recording for as long as the page keeps this connection open."""
        if self._broker.tls is not None:
            raise DeviceError(
                "the broker uses TLS; play the recording with `tacshade-edge replay --play "
                "--config FILE`"
            )
        try:
            async with asyncio.timeout(_END_S + 1.0):  # the previous one may still be ending
                await self._player.acquire()
        except TimeoutError:
            raise DeviceError("this dashboard is already playing another recording") from None
        self._played = str(path)
        try:
            async with _replaying(path, self._broker) as process:
                await _answer(page, ok=True, sensor=PLAYED_AS)
                assert process.stderr is not None
                left = asyncio.ensure_future(page.wait_closed())
                said = asyncio.ensure_future(_last_line(process.stderr))
                await asyncio.wait((left, said), return_when=asyncio.FIRST_COMPLETED)
                if said.done():
                    await _answer(
                        page, ok=False, error=f"{path.name}: {said.result() or 'its replay ended'}"
                    )
                for task in (left, said):
                    task.cancel()
        finally:
            self._played = ""
            self._player.release()


@contextlib.asynccontextmanager
async def _replaying(path: Path, broker: Broker) -> AsyncIterator[asyncio.subprocess.Process]:
    words = (
        "replay",
        str(path.resolve()),
        "--play",
        "--mqtt",
        str(broker),
        "--sensor-id",
        PLAYED_AS,
    )
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "tacshade_edge",
        *words,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        try:
            async with asyncio.timeout(_END_S):
                await process.wait()
        finally:
            if process.returncode is None:
                process.kill()


async def _last_line(stream: asyncio.StreamReader) -> str:
    last = b""
    while line := await stream.readline():
        last = line.strip() or last
    return escaped(last.decode(errors="replace"), 200)


def _command(message: str | bytes) -> dict[str, Any]:
    with contextlib.suppress(ValueError, RecursionError):
        command = json.loads(message)
        if isinstance(command, dict):
            return command
    raise DeviceError("expected a JSON object")


async def _answer(page: ServerConnection, **answer: object) -> None:
    async with asyncio.timeout(STALL_S):
        await page.send(json.dumps(answer))
