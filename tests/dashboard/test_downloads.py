"""Downloads of recordings through the real server: slow, stalled, many at once, and in parts."""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import tarfile
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import connect

from support.page_server import TOKEN, echo, get, running, tcp, websocket
from support.recordings import recorded
from tacshade_edge.dashboard import downloads
from tacshade_edge.dashboard.downloads import DOWNLOADS_MAX
from tacshade_edge.dashboard.recording_tar import tar_of

pytestmark = pytest.mark.slow
RUN = "/recordings/run.tar"
LARGE_BYTES = 48 << 20
CLIENTS = 100
"""More than the kernel's buffers of both sides hold."""


@pytest.fixture
def large(tmp_path: Path) -> Path:
    path = recorded(tmp_path / "recs", "run")
    with (path / "large.bin").open("wb") as stream:
        stream.truncate(LARGE_BYTES)
    return path.parent


@asynccontextmanager
async def http(port: int, path: str) -> AsyncIterator[asyncio.StreamReader]:
    """A client that reads only what the test reads."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1 << 12)
    writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
    yield reader
    writer.transport.abort()


async def asked(port: int, **command: Any) -> Any:
    words: dict[str, Any] = {"subprotocols": ["tacshade-recordings"], "compression": None}
    async with connect(f"ws://127.0.0.1:{port}/recordings", **words) as asking:
        await asking.send(json.dumps(command))
        return json.loads(await asking.recv())


async def test_only_a_stall_ends_a_download_and_the_log_names_it(
    large: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(downloads, "STALL_S", 0.2)
    async with running(recordings=large) as port:
        async with http(port, RUN) as reader:
            while "nothing was taken" not in caplog.text:
                await asyncio.sleep(0.01)
            got = 0
            with contextlib.suppress(ConnectionError):
                while some := await reader.read(1 << 16):
                    got += len(some)
        assert got < LARGE_BYTES
        assert "ended the download of" in caplog.text
        assert (await asked(port, action="list"))["ok"]


async def test_a_hundred_come_and_go_beside_one_that_reads_bytes_and_one_that_reads_all(
    large: Path, record_property: Callable[[str, object], None]
) -> None:
    record_property("tried", CLIENTS)
    descriptors = Path("/proc/self/fd")
    before = len(list(descriptors.iterdir()))
    got, whole = 0, tar_of(large / "run").size_bytes
    async with running(recordings=large) as port, http(port, RUN) as slow:
        async with http(port, RUN) as fast:
            for k in range(CLIENTS):
                async with http(port, RUN) as gone:
                    await gone.read(k % 3)
                assert len(await slow.read(1)) == 1
                got += len(await fast.read(1 << 12))
            while some := await fast.read(1 << 12):
                got += len(some)
        assert got > whole
        assert (await asked(port, action="list"))["ok"]
    while len(list(descriptors.iterdir())) > before:
        await asyncio.sleep(0.01)


async def test_pages_never_wait_for_downloads_and_too_many_are_refused(large: Path) -> None:
    async with (
        tcp(echo) as broker,
        running(broker, recordings=large, host="localhost") as port,
        asyncio.TaskGroup() as group,
    ):
        enough = asyncio.Event()

        async def stalled() -> None:
            async with http(port, RUN) as reader:
                await reader.readexactly(1 << 12)
                begun.release()
                await enough.wait()

        begun = asyncio.Semaphore(0)
        for _ in range(DOWNLOADS_MAX):
            group.create_task(stalled())
        for _ in range(DOWNLOADS_MAX):
            await begun.acquire()
        assert (await asked(port, action="list"))["ok"]
        async with websocket(port) as live:
            await live.send(b"hello")
            assert await live.recv() == b"hello"
        status, headers, body = await get(port, "/recordings/run.tar")
        assert (status, headers["retry-after"]) == (503, "10")
        assert f"{DOWNLOADS_MAX} downloads are running".encode() in body
        enough.set()


async def test_a_download_resumes_where_it_was_cut_off(tmp_path: Path) -> None:
    path = recorded(tmp_path, "left-thumb/run")
    (path / "more.bin").write_bytes(bytes(range(256)) * 1000)
    where = "/recordings/left-thumb/run.tar"
    async with running(recordings=tmp_path) as port:
        status, headers, whole = await get(port, where)
        size, etag = len(whole), headers["etag"]
        assert (status, headers["accept-ranges"], headers["content-length"]) == (
            200,
            "bytes",
            f"{size}",
        )
        with tarfile.open(fileobj=io.BytesIO(whole)) as opened:
            assert len(opened.getnames()) == 4
        for asked, start, stop in (
            ("0-0", 0, 1),
            ("700-200000", 700, 200_001),
            ("1000-", 1000, size),
            ("-512", size - 512, size),
            (f"5-{10**14}", 5, size),
        ):
            for more in ((), (f"If-Range: {etag}",)):
                status, headers, part = await get(port, where, f"Range: bytes={asked}", *more)
                assert (status, part) == (206, whole[start:stop])
                assert headers["content-range"] == f"bytes {start}-{stop - 1}/{size}"
        status, headers, part = await get(port, where, f"Range: bytes={size}-")
        assert (status, headers["content-range"], part) == (416, f"bytes */{size}", b"")
        for odd in ("bytes=0-1,5-9", "bytes=9-1", "bytes=-", "rows=0-1", "bytes=" + "9" * 99 + "-"):
            status, _, part = await get(port, where, f"Range: {odd}")
            assert (status, part) == (200, whole)
        (path / "more.bin").write_bytes(b"other")
        status, _, part = await get(port, where, "Range: bytes=1000-", f"If-Range: {etag}")
        assert (status, len(part)) == (200, tar_of(path).size_bytes)


async def test_only_recordings_are_downloaded_and_by_no_stranger(tmp_path: Path) -> None:
    recorded(tmp_path, "outside")
    recorded(tmp_path / "recs", "run")
    async with running(recordings=tmp_path / "recs") as port:
        for name in ("none", "..%2Foutside", "../outside", "%2e%2e/outside", "a/b/c", ""):
            assert (await get(port, f"/recordings/{name}.tar"))[0] == 404
        twice = ("Range: bytes=0-1",) * 2
        assert (await get(port, "/recordings/run.tar", *twice))[0] == 400
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET /recordings/run.tar HTTP/1.1\r\nHost: evil.example\r\n\r\n")
        assert (await reader.read()).startswith(b"HTTP/1.1 403")
        writer.close()
    async with running(recordings=tmp_path / "recs", token=TOKEN) as port:
        assert (await get(port, "/recordings/run.tar"))[0] == 401
        known = f"Authorization: Bearer {TOKEN}"
        assert (await get(port, "/recordings/run.tar", known))[0] == 200
    async with running() as port:
        assert (await get(port, "/recordings/run.tar"))[0] == 404
