"""Downloads of recordings over HTTP, with ranges: only a stall ends one, and none of them
holds up a page.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import logging
import re
import struct
import termios
from collections.abc import AsyncIterator, Awaitable, Callable, Generator, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus
from pathlib import Path
from typing import Final, TypeVar

from websockets.asyncio.server import ServerConnection

from tacshade_edge.dashboard.recording_tar import CHUNK_BYTES, Tar, tar_of
from tacshade_edge.errors import DeviceError
from tacshade_edge.quoting import escaped

_log = logging.getLogger(__name__)
T = TypeVar("T")

READERS: Final = 2
"""Threads that read files for all downloads; each reads one piece and is free again, so a slow
client holds none.
"""
DOWNLOADS_MAX: Final = 8
"""At once; any further one is refused with 503, so that places for pages are left."""
RETRY_S: Final = 10
STALL_S: Final = 120.0
"""A download ends if its client takes no byte for so long, however slow it is otherwise. A client's
kernel asks for more only when a sixteenth of its buffer is free, 2 MB of one of 32 MB: at
256 kbit/s, once a minute.
"""
ASKED: Final = ("Range", "If-Range")
"""The headers that matter to `Downloads.answer`."""
_RANGE: Final = re.compile(r"bytes=(\d{0,15})-(\d{0,15})", re.ASCII)


class StallError(Exception):
    """The client took nothing for `STALL_S`."""


class BusyError(DeviceError):
    """Too many downloads are running."""


class Downloads:
    """Reads recordings and sends them."""

    def __init__(self) -> None:
        self._running = 0
        self._readers = ThreadPoolExecutor(READERS, thread_name_prefix="download")

    async def _read(self, call: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._readers, call)

    @contextlib.contextmanager
    def place(self) -> Iterator[None]:
        """Hold one of the places. Raises BusyError."""
        if self._running >= DOWNLOADS_MAX:
            raise BusyError(f"{DOWNLOADS_MAX} downloads are running, the limit; try again later")
        self._running += 1
        try:
            yield
        finally:
            self._running -= 1

    async def tar(self, path: Path) -> Tar:
        """The tar of a recording. Raises DeviceError."""
        return await self._read(lambda: tar_of(path))

    @contextlib.asynccontextmanager
    async def _pieces(
        self, pieces: Generator[bytes, None, None]
    ) -> AsyncIterator[AsyncIterator[bytes]]:
        async def read() -> AsyncIterator[bytes]:
            while piece := await self._read(lambda: _gathered(pieces)):
                yield piece

        try:
            yield read()
        finally:
            # Of a download that broke off, a file stays open until garbage is collected.
            # By a reader, as all that may block; if one is just reading, its end closes the file.
            self._readers.submit(pieces.close)

    async def answer(
        self, page: ServerConnection, tar: Tar, headers: Mapping[str, str], *, body: bool
    ) -> None:
        """Answer an HTTP request for a tar, with what `headers` ask of it, and close."""
        status, start, stop = _asked(tar, headers)
        lines = [f"HTTP/1.1 {status.value} {status.phrase}", "Connection: close"]
        lines += ["Accept-Ranges: bytes", f"ETag: {tar.etag}", "Cache-Control: no-cache"]
        lines += ["Content-Type: application/x-tar", f"Content-Length: {stop - start}"]
        lines += [f'Content-Disposition: attachment; filename="{tar.folder.name}.tar"']
        lines += ["X-Content-Type-Options: nosniff"]
        if status is HTTPStatus.PARTIAL_CONTENT:
            lines.append(f"Content-Range: bytes {start}-{stop - 1}/{tar.size_bytes}")
        if status is HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
            lines.append(f"Content-Range: bytes */{tar.size_bytes}")
        page.transport.write("\r\n".join([*lines, "", ""]).encode())
        with _stalls(page, tar):
            if body:
                await self._send_body(page, tar.pieces(start, stop))
            page.transport.close()
            await progressing(page, asyncio.shield(page.connection_lost_waiter))

    async def _send_body(
        self, page: ServerConnection, content: Generator[bytes, None, None]
    ) -> None:
        try:
            async with self._pieces(content) as pieces:
                async for piece in pieces:
                    if page.transport.is_closing():
                        return
                    page.transport.write(piece)
                    await progressing(page, page.drain())
        except DeviceError as error:
            # The status has been sent. What is cut short does not look whole.
            _log.warning("ended a download: %s", escaped(str(error)))
            page.transport.abort()


def _gathered(pieces: Iterator[bytes]) -> bytes:
    """The next pieces, about `CHUNK_BYTES` in all: most files of a recording are small."""
    found: list[bytes] = []
    while sum(map(len, found)) < CHUNK_BYTES and (piece := next(pieces, b"")):
        found.append(piece)
    return b"".join(found)


@contextlib.contextmanager
def _stalls(page: ServerConnection, tar: Tar) -> Iterator[None]:
    """Log a stall and close the connection."""
    try:
        yield
    except StallError:
        found = "ended the download of %s: nothing was taken for %.0f s"
        _log.warning(found, escaped(str(tar.folder)), STALL_S)
        page.transport.abort()


async def progressing(page: ServerConnection, sent: Awaitable[object]) -> None:
    """Wait until something is sent, for as long as the client takes bytes. Raises StallError."""
    waiting = asyncio.ensure_future(sent)
    try:
        while True:
            before = _untaken(page)
            await asyncio.wait((waiting,), timeout=STALL_S)
            if waiting.done():
                await waiting
                return
            if _untaken(page) >= before:
                raise StallError
    finally:
        waiting.cancel()


def _untaken(page: ServerConnection) -> int:
    """Bytes that wait here or in the kernel until the client's machine has taken them."""
    waiting = page.transport.get_write_buffer_size()
    with contextlib.suppress(OSError, ValueError):
        connection = page.transport.get_extra_info("socket")
        # The kernel asks for more only when a third of its buffer, up to 4 MB, is free.
        queued = fcntl.ioctl(connection.fileno(), termios.TIOCOUTQ, bytes(4))
        waiting += struct.unpack("i", queued)[0]
    return waiting


def _asked(tar: Tar, headers: Mapping[str, str]) -> tuple[HTTPStatus, int, int]:
    """The status and which bytes to send: of several ranges, or for another tar, all of them."""
    whole = HTTPStatus.OK, 0, tar.size_bytes
    found = _RANGE.fullmatch(headers.get("Range", "").replace(" ", ""))
    if found is None or headers.get("If-Range", tar.etag) != tar.etag or not any(found.groups()):
        return whole
    first, last = found.groups()
    # Without a first byte, it asks for so many at the end.
    start = int(first) if first else max(tar.size_bytes - int(last), 0)
    stop = min(int(last) + 1, tar.size_bytes) if first and last else tar.size_bytes
    if first and last and int(last) < int(first):
        return whole
    if start >= stop:
        return HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, 0, 0
    return HTTPStatus.PARTIAL_CONTENT, start, stop
