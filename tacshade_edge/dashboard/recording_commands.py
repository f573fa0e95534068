"""A page's commands on recordings, one per WebSocket: list, download, delete, play."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Final

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from tacshade_edge.dashboard import recordings
from tacshade_edge.dashboard.bridge import STALL_S, Broker
from tacshade_edge.errors import DeviceError
from tacshade_edge.quoting import escaped, shown

_log = logging.getLogger(__name__)

PLAYED_AS: Final = "recording"
"""Sensor ID of a played recording on the broker."""
_ASK_S: Final = 5.0
_END_S: Final = 3.0
_READ_ONLY: Final = ("list", "download")


class RecordingCommands:
    """The commands of pages on one folder; at most one recording plays at a time.

    Parameters
    ----------
    folder : Path or None
        None rejects every command.
    broker : Broker
        Broker that receives a played recording.
    read_only : bool
        Pages may only list and download.
    """

    def __init__(self, folder: Path | None, broker: Broker, *, read_only: bool) -> None:
        self._folder = folder
        self._broker = broker
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
            raise DeviceError("this dashboard lists no recordings: it was started without --recordings")
        if self._read_only and action not in _READ_ONLY:
            raise DeviceError("read-only: this dashboard forwards no requests")
        if action == "list":
            found = await asyncio.to_thread(recordings.listed, folder)
            await _answer(page, ok=True, recordings=[recording.as_dict() for recording in found])
        elif action == "download":
            await self._download(page, await asyncio.to_thread(recordings.find, folder, name))
        elif action == "delete":
            path = await asyncio.to_thread(recordings.find, folder, name)
            if self._played == str(path):
                raise DeviceError(f"{shown(str(name))} is playing")
            await asyncio.to_thread(recordings.delete, path)
            _log.info("a page deleted the recording %s", path)
            await _answer(page, ok=True)
        elif action == "play":
            await self._play(page, await asyncio.to_thread(recordings.find, folder, name))
        else:
            raise DeviceError("found an unknown action, expected list, download, delete or play")

    async def _download(self, page: ServerConnection, path: Path) -> None:
        await _answer(page, ok=True, bytes=await asyncio.to_thread(recordings.tar_bytes, path))
        loop = asyncio.get_running_loop()

        async def send(piece: bytes) -> None:
            async with asyncio.timeout(STALL_S):
                await page.send(piece)

        await asyncio.to_thread(
            recordings.tar, path, lambda piece: asyncio.run_coroutine_threadsafe(send(piece), loop).result()
        )

    async def _play(self, page: ServerConnection, path: Path) -> None:
        """Play a recording for as long as the page keeps this connection open."""
        if self._broker.tls is not None:
            raise DeviceError(
                "the broker uses TLS; play the recording with `tacshade-edge replay --play --config FILE`"
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
                    await _answer(page, ok=False, error=f"{path.name}: {said.result() or 'its replay ended'}")
                for task in (left, said):
                    task.cancel()
        finally:
            self._played = ""
            self._player.release()


@contextlib.asynccontextmanager
async def _replaying(path: Path, broker: Broker) -> AsyncIterator[asyncio.subprocess.Process]:
    words = ("replay", str(path.resolve()), "--play", "--mqtt", str(broker), "--sensor-id", PLAYED_AS)
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "tacshade_edge", *words),
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
    try:
        command = json.loads(message)
    except (ValueError, RecursionError):
        command = None
    if not isinstance(command, dict):
        raise DeviceError("expected a JSON object")
    return command


async def _answer(page: ServerConnection, **answer: object) -> None:
    async with asyncio.timeout(STALL_S):
        await page.send(json.dumps(answer))
