"""The dashboard's server: its files, its methods, and how many it serves; real sockets."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import re
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from support.page_server import answer, echo, get, running, tcp, websocket
from tacshade_edge.dashboard import server
from tacshade_edge.dashboard.page_files import load, security_headers
from tacshade_edge.dashboard.server import CONNECTIONS_MAX, PAGES_MAX

STATIC = Path(server.__file__).parent / "static"


async def test_the_page_and_all_that_it_names_is_served() -> None:
    async with running() as port:
        status, headers, index = await get(port, "/")
        assert (status, headers["content-type"]) == (200, "text/html; charset=utf-8")
        assert index == (STATIC / "index.html").read_bytes()
        named = re.findall(r'(?:src|href)="([^"]+)"', index.decode())
        named += re.findall(r'"three": "\./([^"]+)"', index.decode())
        for script in STATIC.glob("*.js"):
            named += re.findall(r'from "\./([^"]+)"', script.read_text())
        types = {
            "js": "text/javascript; charset=utf-8",
            "css": "text/css; charset=utf-8",
            "svg": "image/svg+xml",
        }
        assert len(set(named)) > 10
        for name in set(named):
            status, headers, body = await get(port, f"/{name}?v=1")
            assert (status, headers["content-type"]) == (200, types[name.rpartition(".")[2]]), name
            assert body == (STATIC / name).read_bytes()


def test_nothing_is_named_that_is_not_here() -> None:
    """Offline means: no address of another machine in the page's own files."""
    for path in [*STATIC.glob("*.js"), *STATIC.glob("*.html"), *STATIC.glob("*.css")]:
        assert re.findall(r"(?:https?:)?//[a-z0-9-]+\.[a-z]", path.read_text()) == [], path.name


async def test_a_file_is_sent_once() -> None:
    async with running() as port:
        _, headers, _ = await get(port, "/main.js")
        status, again, body = await get(port, "/main.js", f"If-None-Match: {headers['etag']}")
        assert (status, body, again["etag"]) == (304, b"", headers["etag"])
        assert (await get(port, "/main.js", 'If-None-Match: "other"'))[0] == 200
        assert (await get(port, "/main.js", *['If-None-Match: "other"'] * 2))[0] == 400
        assert (await get(port, "/mqtt", *["Upgrade: websocket"] * 2))[0] == 400


@pytest.mark.parametrize(
    "path",
    [
        "/../server.py",
        "/%2e%2e/server.py",
        "//etc/passwd",
        "/vendor/",
        "/vendor/vendored.md",
        "/index.html/",
        "http://127.0.0.1/main.js",
    ],
)
async def test_what_is_not_in_the_table_does_not_exist(path: str) -> None:
    async with running() as port:
        assert (await get(port, path))[0] == 404


async def test_the_page_may_load_its_own_files_only() -> None:
    async with running() as port:
        for path in ("/", "/main.js", "/none"):
            headers = (await get(port, path))[1]
            policy = headers["content-security-policy"]
            assert "default-src 'none'" in policy
            assert "frame-ancestors 'none'" in policy
            assert "unsafe" not in policy
            assert headers["x-content-type-options"] == "nosniff"
        # The one inline script is allowed by its hash,
        # so the hash has to be that of the page as it is.
        assert policy.count("'sha256-") == (STATIC / "index.html").read_text().count(
            '<script type="importmap">'
        )


def test_pages_that_may_show_it_in_a_frame_are_named() -> None:
    files = load(read_only=False, recordings=False)
    home = "http://homeassistant.local:8123"
    policy = security_headers(files, {home})["Content-Security-Policy"]
    assert policy.endswith(f"; frame-ancestors {home}")
    assert security_headers(files)["Content-Security-Policy"].endswith("; frame-ancestors 'none'")


@pytest.mark.parametrize("method", ["PUT", "POST", "get"])
async def test_other_methods_than_get_and_head_are_not_allowed(method: str) -> None:
    async with running() as port:
        said = await answer(port, f"{method} /main.js HTTP/1.1\r\nHost: a\r\n\r\n".encode())
        assert said.startswith(b"HTTP/1.1 405 ")
        assert b"\r\nAllow: GET, HEAD\r\n" in said


async def test_so_many_pages_and_no_more(caplog: pytest.LogCaptureFixture) -> None:
    async with tcp(echo) as broker, running(broker) as port:
        pages = [await websocket(port).__aenter__() for _ in range(PAGES_MAX)]
        with pytest.raises(InvalidStatus) as refused:
            await websocket(port).__aenter__()
        assert refused.value.response.status_code == 503
        assert refused.value.response.body == b"16 pages are already open, the limit\n"
        assert (await get(port, "/"))[0] == 200
        await pages.pop().close()
        async with websocket(port) as page:
            await page.send(b"hello")
            assert await page.recv() == b"hello"
        for page in pages:
            page.transport.abort()
    reported = [record.getMessage() for record in caplog.records]
    assert reported == ["rejected a connection (1 so far): 16 pages are already open, the limit"]


async def test_so_many_connections_and_no_more(caplog: pytest.LogCaptureFixture) -> None:
    async with running() as port:
        mute = [await asyncio.open_connection("127.0.0.1", port) for _ in range(CONNECTIONS_MAX)]
        with contextlib.suppress(ConnectionError):
            assert await answer(port, b"GET / HTTP/1.1\r\nHost: a\r\n\r\n") == b""
        for _, writer in mute:
            writer.close()
        while True:
            with contextlib.suppress(ConnectionError):
                if (await answer(port, b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"))[
                    :12
                ] == b"HTTP/1.1 200":
                    break
            await asyncio.sleep(0.01)
    reported = caplog.records[0].getMessage()
    assert (
        reported == "rejected a connection (1 so far): 48 connections are already open, the limit"
    )


@pytest.mark.slow
async def test_pings_that_are_never_read_do_not_fill_the_memory(
    caplog: pytest.LogCaptureFixture,
) -> None:
    ping = b"\x89\xfd\0\0\0\0" + bytes(125)

    async with tcp(echo) as broker, running(broker) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1)
        key = b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Protocol: mqtt\r\n"
        upgrade = b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        writer.write(b"GET /mqtt HTTP/1.1\r\nHost: a\r\n" + upgrade + key + b"\r\n")
        await reader.readexactly(12)
        assert isinstance(writer.transport, asyncio.Transport)
        writer.transport.pause_reading()

        async def flood() -> None:
            while True:
                writer.write(ping * 1000)
                await writer.drain()

        with pytest.raises(ConnectionError):
            await flood()
        assert (await get(port, "/"))[0] == 200
    assert len(caplog.records) < 10


async def test_it_stops_with_open_connections() -> None:
    async with tcp(echo) as broker:
        async with running(broker) as port:
            pages = [await websocket(port).__aenter__() for _ in range(3)]
            began = asyncio.get_running_loop().time()
        assert (
            asyncio.get_running_loop().time() - began < 5
        )  # it is 0.01 s; a close time-out would be 10
        for page in pages:
            with pytest.raises(ConnectionClosed):
                await page.recv()


def test_vendored_files_are_the_ones_that_are_listed() -> None:
    text = (STATIC / "vendor" / "vendored.md").read_text()
    listed = dict(re.findall(r"^\| (\S+) \|.*\| `([0-9a-f]{64})` \|$", text, re.MULTILINE))
    found = {path for path in (STATIC / "vendor").iterdir() if path.suffix in (".js", ".css")}
    assert listed == {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in found}
    assert sum(path.stat().st_size for path in found) < 2_000_000
