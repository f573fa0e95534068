"""The dashboard's server: its files, who may open the WebSocket, and the bytes through it; real sockets."""

from __future__ import annotations

import asyncio
import hashlib
import re
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion
from support.page_server import TOKEN, run, running
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from tacshade_edge.dashboard import bridge, files
from tacshade_edge.dashboard.access import refusal
from tacshade_edge.dashboard.bounds import CONNECTIONS_MAX, PAGES_MAX
from tacshade_edge.dashboard.login import WRONG_MAX
from tools.testbed.certificate import certificate
from tools.testbed.dashboard_process import dashboard
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.patience import wait_until

STATIC = Path(files.__file__).parent / "static"
Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@asynccontextmanager
async def tcp(serve: Serve) -> AsyncIterator[int]:
    """A TCP server in the place of the broker."""
    listener = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with listener:
        yield int(listener.sockets[0].getsockname()[1])


def websocket(port: int, **words: Any) -> connect:
    return connect(f"ws://127.0.0.1:{port}/mqtt", subprotocols=["mqtt"], compression=None, max_size=None, **words)


async def get(port: int, path: str, *headers: str) -> tuple[int, dict[str, str], bytes]:
    """A request exactly as written: no client tidies the path."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    lines = [f"GET {path} HTTP/1.1", f"Host: 127.0.0.1:{port}", *headers]
    writer.write("\r\n".join([*lines, "", ""]).encode())
    head, _, body = (await reader.read()).partition(b"\r\n\r\n")
    writer.close()
    status, *fields = head.decode().split("\r\n")
    return int(status.split()[1]), {k.lower(): v for k, v in (f.split(": ", 1) for f in fields)}, body


async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while chunk := await reader.read(65536):
        writer.write(chunk)
        await writer.drain()
    writer.close()


def test_the_page_and_all_that_it_names_is_served() -> None:
    async def test() -> None:
        async with running() as port:
            status, headers, index = await get(port, "/")
            assert (status, headers["content-type"]) == (200, "text/html; charset=utf-8")
            assert index == (STATIC / "index.html").read_bytes()
            named = re.findall(r'(?:src|href)="([^"]+)"', index.decode())
            named += re.findall(r'"three": "\./([^"]+)"', index.decode())
            for script in STATIC.glob("*.js"):
                named += re.findall(r'from "\./([^"]+)"', script.read_text())
            types = {"js": "text/javascript; charset=utf-8", "css": "text/css; charset=utf-8", "svg": "image/svg+xml"}
            assert len(set(named)) > 10
            for name in set(named):
                status, headers, body = await get(port, f"/{name}?v=1")
                assert (status, headers["content-type"]) == (200, types[name.rpartition(".")[2]]), name
                assert body == (STATIC / name).read_bytes()

    run(test())


def test_nothing_is_named_that_is_not_here() -> None:
    """Offline means: no address of another machine in the page's own files."""
    for path in [*STATIC.glob("*.js"), *STATIC.glob("*.html"), *STATIC.glob("*.css")]:
        assert re.findall(r"(?:https?:)?//[a-z0-9-]+\.[a-z]", path.read_text()) == [], path.name


def test_a_file_is_sent_once() -> None:
    async def test() -> None:
        async with running() as port:
            _, headers, _ = await get(port, "/main.js")
            status, again, body = await get(port, "/main.js", f"If-None-Match: {headers['etag']}")
            assert (status, body, again["etag"]) == (304, b"", headers["etag"])
            assert (await get(port, "/main.js", 'If-None-Match: "other"'))[0] == 200

    run(test())


@pytest.mark.parametrize(
    "path",
    [
        "/../server.py",
        "/vendor/../../server.py",
        "/%2e%2e/server.py",
        "/..%2fserver.py",
        "//etc/passwd",
        "/etc/passwd",
        "/vendor/",
        "/vendor",
        "/static/index.html",
        "/vendor/vendored.md",
        "/index.html/",
        "/\\..\\server.py",
        "http://127.0.0.1/main.js",
    ],
)
def test_what_is_not_in_the_table_does_not_exist(path: str) -> None:
    async def test() -> None:
        async with running() as port:
            assert (await get(port, path))[0] == 404

    run(test())


def test_the_page_may_load_its_own_files_only() -> None:
    async def test() -> None:
        async with running() as port:
            for path in ("/", "/main.js", "/none"):
                headers = (await get(port, path))[1]
                policy = headers["content-security-policy"]
                assert "default-src 'none'" in policy
                assert "frame-ancestors 'none'" in policy
                assert "unsafe" not in policy
                assert headers["x-content-type-options"] == "nosniff"
            # The one inline script is allowed by its hash, so the hash has to be that of the page as it is.
            assert policy.count("'sha256-") == (STATIC / "index.html").read_text().count('<script type="importmap">')

    run(test())


@pytest.mark.parametrize(
    ("origin", "host", "passes"),
    [
        ("http://127.0.0.1:8080", "127.0.0.1:8080", True),
        ("http://localhost:8080", "localhost:8080", True),
        ("http://[::1]:8080", "[::1]:8080", True),
        ("http://192.168.1.7:8080", "192.168.1.7:8080", True),
        ("https://hand.example", "hand.example", True),  # given with --origin
        ("https://hand.example", "127.0.0.1:8080", True),  # as many proxies ask
        (None, "127.0.0.1:8080", True),  # no browser
        ("http://evil.example", "127.0.0.1:8080", False),
        ("http://127.0.0.1:9999", "127.0.0.1:8080", False),  # another server on this machine
        ("http://evil.example:8080", "evil.example:8080", False),  # its name, our address
        ("http://localhost.evil.example", "localhost.evil.example", False),
        ("null", "127.0.0.1:8080", False),  # a file, a sandboxed frame
        ("http://127.0.0.1:8080", None, False),
        ("", "", False),
    ],
)
def test_who_may_open_the_websocket(origin: str | None, host: str | None, passes: bool) -> None:
    assert (refusal(origin, host, {"https://hand.example"}) == "") is passes


def test_another_page_is_refused_before_any_byte_reaches_the_broker(caplog: pytest.LogCaptureFixture) -> None:
    connected = []

    async def count(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connected.append(1)
        writer.close()

    async def test() -> None:
        async with tcp(count) as broker, running(broker) as port:
            with pytest.raises(InvalidStatus) as refused:
                await websocket(port, origin="http://evil.example").__aenter__()
            assert refused.value.response.status_code == 403
            assert b"expected one from here" in (refused.value.response.body or b"")
            with pytest.raises(InvalidStatus):
                await websocket(port, origin="http://evil.example").__aenter__()
            assert (await get(port, "/mqtt"))[0] == 426
            assert connected == []
            async with websocket(port, origin=f"http://127.0.0.1:{port}") as page:
                with pytest.raises(ConnectionClosed):
                    await page.recv()
            assert connected == [1]

    run(test())
    assert [r.getMessage().count("--origin http://evil.example") for r in caplog.records] == [1]  # told once


def test_bytes_pass_both_ways_unchanged() -> None:
    sent = [bytes([n]) * (1 + n * 997) for n in range(60)]

    async def receive(page: ClientConnection, size: int) -> bytes:
        received = b""
        while len(received) < size:
            message = await page.recv()
            assert isinstance(message, bytes)
            received += message
        return received

    async def test() -> None:
        async with tcp(echo) as broker, running(broker) as port, websocket(port) as page:
            assert page.subprotocol == "mqtt"
            receiving = asyncio.create_task(receive(page, sum(map(len, sent))))
            for message in sent:
                await page.send(message)
            assert await receiving == b"".join(sent)

    run(test())


@pytest.mark.parametrize(("message", "code"), [("text", 1003), (b"x" * (1 << 17), 1009)])
def test_what_is_no_mqtt_is_refused(message: str | bytes, code: int) -> None:
    async def test() -> None:
        async with tcp(echo) as broker, running(broker) as port, websocket(port) as page:
            await page.send(message)
            with pytest.raises(ConnectionClosed) as closed:
                await page.recv()
            assert closed.value.rcvd is not None
            assert closed.value.rcvd.code == code

    run(test())


def test_a_broker_that_is_away_is_told_and_tried_again() -> None:
    async def reason(port: int) -> str:
        async with websocket(port) as page:
            with pytest.raises(ConnectionClosed) as closed:
                await page.recv()
            assert closed.value.rcvd is not None
            assert closed.value.rcvd.code == 1013
            return closed.value.rcvd.reason

    async def hang_up(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.close()

    async def test() -> None:
        async with tcp(echo) as broker:
            pass
        async with running(broker) as port:
            assert await reason(port) == f"broker 127.0.0.1:{broker}: connection refused"
            listener = await asyncio.start_server(hang_up, "127.0.0.1", broker)
            async with listener:
                assert await reason(port) == f"broker 127.0.0.1:{broker} closed the connection"
            assert (await get(port, "/"))[0] == 200

    run(test())


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "::1"])
def test_a_closed_port_is_told_in_two_words(host: str) -> None:
    """A name of several addresses fails in another way than one address."""

    async def refused(_reader: asyncio.StreamReader, _writer: asyncio.StreamWriter) -> None:
        raise AssertionError("nobody may come here")

    async def test() -> None:
        async with tcp(refused) as broker:
            pass
        async with running(broker, host=host) as port, websocket(port) as page:
            with pytest.raises(ConnectionClosed) as closed:
                await page.recv()
            assert closed.value.rcvd is not None
            assert closed.value.rcvd.reason.endswith(f":{broker}: connection refused")

    run(test())


def test_a_page_that_goes_away_leaves_no_connection_at_the_broker() -> None:
    ended = asyncio.Event()

    async def until_end(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read()
        ended.set()
        writer.close()

    async def test() -> None:
        async with tcp(until_end) as broker, running(broker) as port:
            async with websocket(port) as page:
                await page.send(b"hello")
                page.transport.abort()  # no closing frame: a tab that crashed
            await ended.wait()

    run(test())


def test_a_page_that_does_not_read_makes_the_broker_wait() -> None:
    """The server holds some hundred KB, the kernel some MB; the broker notices, and drops by its own rules."""
    written = 0

    async def flood(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal written
        try:
            while True:
                writer.write(bytes(65536))
                await writer.drain()
                written += 65536
        except ConnectionError:
            pass

    async def test() -> None:
        async with tcp(flood) as broker, running(broker) as port, websocket(port, max_queue=1) as page:
            await page.recv()
            before = -1
            while written != before:
                before = written
                await asyncio.sleep(0.1)
            assert 0 < written < 64 << 20
            page.transport.abort()

    run(test())


async def answer(port: int, request: bytes) -> bytes:
    """All that comes back; empty where the connection is closed."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request)
    try:
        return await reader.read()
    except ConnectionError:
        return b""
    finally:
        writer.close()


@pytest.mark.parametrize("method", ["PUT", "POST", "DELETE", "TRACE", "OPTIONS", "PATCH", "get", "X"])
@pytest.mark.parametrize("path", ["/", "/main.js", "/none", "/mqtt"])
def test_other_methods_than_get_and_head_are_not_allowed(method: str, path: str) -> None:
    async def test() -> None:
        async with running() as port:
            said = await answer(port, f"{method} {path} HTTP/1.1\r\nHost: a\r\n\r\n".encode())
            assert said.startswith(b"HTTP/1.1 405 ")
            assert b"\r\nAllow: GET, HEAD\r\n" in said

    run(test())


def test_head_is_get_without_the_body() -> None:
    async def test() -> None:
        async with running() as port:
            for path in ("/main.js", "/none"):
                got = await answer(port, f"GET {path} HTTP/1.1\r\nHost: a\r\n\r\n".encode())
                head = await answer(port, f"HEAD {path} HTTP/1.1\r\nHost: a\r\n\r\n".encode())
                assert head == got.partition(b"\r\n\r\n")[0] + b"\r\n\r\n"

    run(test())


def test_so_many_pages_and_no_more(caplog: pytest.LogCaptureFixture) -> None:
    async def test() -> None:
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

    run(test())
    told = [record.getMessage() for record in caplog.records]
    assert told == ["turned a connection away (1 so far): 16 pages are already open, the limit"]


def test_so_many_connections_and_no_more(caplog: pytest.LogCaptureFixture) -> None:
    async def test() -> None:
        async with running() as port:
            mute = [await asyncio.open_connection("127.0.0.1", port) for _ in range(CONNECTIONS_MAX)]
            assert await answer(port, b"GET / HTTP/1.1\r\nHost: a\r\n\r\n") == b""
            for _, writer in mute:
                writer.close()
            while (await answer(port, b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"))[:12] != b"HTTP/1.1 200":
                await asyncio.sleep(0.01)

    run(test())
    assert (
        caplog.records[0].getMessage()
        == "turned a connection away (1 so far): 48 connections are already open, the limit"
    )


def test_a_page_that_reads_nothing_is_closed_at_the_broker_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge, "STALL_S", 0.3)
    ended = asyncio.Event()

    async def flood(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                writer.write(bytes(65536))
                await writer.drain()
        except ConnectionError:
            ended.set()

    async def test() -> None:
        async with tcp(flood) as broker, running(broker) as port:
            page = await websocket(port, max_queue=1).__aenter__()
            await ended.wait()
            page.transport.abort()

    run(test())


def test_pings_that_are_never_read_do_not_fill_the_memory(caplog: pytest.LogCaptureFixture) -> None:
    ping = b"\x89\xfd\0\0\0\0" + bytes(125)

    async def test() -> None:
        async with tcp(echo) as broker, running(broker) as port:
            reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1)
            key = b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Protocol: mqtt\r\n"
            upgrade = b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            writer.write(b"GET /mqtt HTTP/1.1\r\nHost: a\r\n" + upgrade + key + b"\r\n")
            await reader.readexactly(12)
            reader._transport.pause_reading()  # type: ignore[attr-defined]

            async def flood() -> None:
                while True:
                    writer.write(ping * 1000)
                    await writer.drain()

            with pytest.raises(ConnectionError):
                await flood()
            assert (await get(port, "/"))[0] == 200

    run(test())
    assert len(caplog.records) < 10


def test_without_the_token_there_is_a_login_and_nothing_else() -> None:
    async def test() -> None:
        async with tcp(echo) as broker, running(broker, token=TOKEN) as port:
            for path in sorted(files.load()):
                status, headers, body = await get(port, path)
                if path in ("/", "/index.html"):
                    assert (status, headers["location"], body) == (303, "login", b"")
                elif path in ("/login", "/login.js", "/style.css", "/favicon.svg"):
                    assert status == 200
                else:
                    assert (status, b"token" in body) == (401, True), path
            with pytest.raises(InvalidStatus) as refused:
                await websocket(port).__aenter__()
            assert refused.value.response.status_code == 401

            status, headers, _ = await get(port, "/login", f"Authorization: Bearer {TOKEN}")
            assert status == 204
            cookie, *flags = headers["set-cookie"].split("; ")
            assert {"HttpOnly", "SameSite=Strict", "Path=/"} < set(flags)
            assert "Secure" not in flags
            assert (await get(port, "/", f"Cookie: other=1; {cookie}"))[0] == 200
            assert (await get(port, "/main.js", f"Authorization: bearer {TOKEN}"))[0] == 200
            assert (await get(port, "/", f"Cookie: {cookie}", f"Cookie: {cookie}"))[0] == 400
            # a proxy's own login
            assert (await get(port, "/", f"Cookie: {cookie}", "Authorization: Basic dTpw"))[0] == 200
            async with websocket(port, additional_headers={"Cookie": cookie}) as page:
                await page.send(b"hello")
                assert await page.recv() == b"hello"

    run(test())


def test_wrong_tokens_are_counted_and_then_refused_unseen(caplog: pytest.LogCaptureFixture) -> None:
    async def test() -> None:
        async with running(token=TOKEN) as port:
            for k in range(WRONG_MAX):
                assert (await get(port, "/login", f"Authorization: Bearer wrong{k}"))[0] == 401
            assert (await get(port, "/login", f"Authorization: Bearer {TOKEN}"))[0] == 429
            assert (await get(port, "/login"))[0] == 200

    run(test())
    told = [record.getMessage() for record in caplog.records]
    assert told == [f"rejected a wrong token from 127.0.0.1 ({k} so far)" for k in range(1, WRONG_MAX + 1)]


def test_over_tls_the_cookie_is_sent_over_nothing_else(tmp_path: Path) -> None:
    cert, key = certificate(tmp_path)
    offered = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    offered.load_cert_chain(cert, key)
    trusted = ssl.create_default_context(cafile=cert)

    async def test() -> None:
        async with tcp(echo) as broker, running(broker, token=TOKEN, tls=offered) as port:
            reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=trusted)
            writer.write(f"GET /login HTTP/1.1\r\nHost: a\r\nAuthorization: Bearer {TOKEN}\r\n\r\n".encode())
            said = await reader.read()
            writer.close()
            assert said.startswith(b"HTTP/1.1 204 ")
            assert b"; Secure\r\n" in said
            assert await answer(port, b"GET / HTTP/1.1\r\nHost: a\r\n\r\n") == b""  # without TLS
            address = f"wss://127.0.0.1:{port}/mqtt"
            words = {"Authorization": f"Bearer {TOKEN}"}
            async with connect(address, ssl=trusted, subprotocols=["mqtt"], additional_headers=words) as page:
                await page.send(b"hello")
                assert await page.recv() == b"hello"

    run(test())


def test_handshakes_count_as_connections(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    cert, key = certificate(tmp_path)
    offered = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    offered.load_cert_chain(cert, key)
    trusted = ssl.create_default_context(cafile=cert)

    async def index(port: int) -> bytes:
        try:
            reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=trusted)
        except OSError:
            return b""
        writer.write(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
        said = await reader.read()
        writer.close()
        return said

    async def test() -> None:
        async with running(tls=offered) as port:
            mute = [await asyncio.open_connection("127.0.0.1", port) for _ in range(CONNECTIONS_MAX)]
            assert await index(port) == b""
            for _, writer in mute:
                writer.close()
            while (await index(port))[:12] != b"HTTP/1.1 200":
                await asyncio.sleep(0.01)

    run(test())
    assert (
        caplog.records[0].getMessage()
        == "turned a connection away (1 so far): 48 connections are already open, the limit"
    )


def test_the_page_is_told_when_it_may_only_look() -> None:
    async def test() -> None:
        async with running() as port, running(read_only=True) as read_only:
            _, told, plain = await get(port, "/")
            _, other, marked = await get(read_only, "/")
            assert plain.replace(b'<html lang="en">', b'<html lang="en" data-read-only>') == marked != plain
            assert told["etag"] != other["etag"]

    run(test())


def test_it_stops_with_open_connections() -> None:
    async def test() -> None:
        async with tcp(echo) as broker:
            async with running(broker) as port:
                pages = [await websocket(port).__aenter__() for _ in range(3)]
                began = asyncio.get_running_loop().time()
            assert asyncio.get_running_loop().time() - began < 5  # it is 0.01 s; a close time-out would be 10
            for page in pages:
                with pytest.raises(ConnectionClosed):
                    await page.recv()

    run(test())


def test_vendored_files_are_the_ones_that_are_listed() -> None:
    text = (STATIC / "vendor" / "vendored.md").read_text()
    listed = dict(re.findall(r"^\| (\S+) \|.*\| `([0-9a-f]{64})` \|$", text, re.MULTILINE))
    found = {path for path in (STATIC / "vendor").iterdir() if path.suffix in (".js", ".css")}
    assert listed == {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in found}
    assert sum(path.stat().st_size for path in found) < 2_000_000


needs_broker = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")


def client_through(address: str) -> Client:
    """Paho over WebSocket, through the dashboard's server."""
    host, port = address.removeprefix("http://").rstrip("/").rsplit(":", 1)
    client = Client(CallbackAPIVersion.VERSION2, transport="websockets")
    client.ws_set_options(path="/mqtt")
    client.connect_async(host, int(port))
    return client


@pytest.mark.broker
@needs_broker
@pytest.mark.parametrize("tls", [False, True])
def test_height_maps_of_full_size_come_through_mosquitto(tmp_path: Path, tls: bool) -> None:
    payload = bytes(range(256)) * 2400  # 614 KB, as 640x480 cells
    received: list[bytes] = []
    with Broker(tmp_path, tls=tls) as broker:
        words = ["--ca-file", str(broker.ca)] if tls else []
        with dashboard(f"127.0.0.1:{broker.port}", *words) as address:
            reader, writer = client_through(address), Client(CallbackAPIVersion.VERSION2)
            reader.on_connect = lambda client, *_: client.subscribe("height")
            reader.on_subscribe = lambda *_: writer.loop_start()
            reader.on_message = lambda _client, _data, message: received.append(message.payload)
            writer.on_connect = lambda client, *_: [client.publish("height", payload) for _ in range(10)]
            if tls:
                writer.tls_set(ca_certs=str(broker.ca))
            writer.connect_async("127.0.0.1", broker.port)
            reader.loop_start()
            wait_until(lambda: len(received) == 10, 20, "ten maps")
            for client in (reader, writer):
                client.disconnect()
                client.loop_stop()
    assert set(received) == {payload}


@pytest.mark.broker
@needs_broker
def test_the_brokers_users_are_the_pages_users(tmp_path: Path) -> None:
    answers: list[bool] = []
    with Broker(tmp_path, users={"eve": "right"}) as broker, dashboard(f"127.0.0.1:{broker.port}") as address:
        for password in ("wrong", "right"):
            client = client_through(address)
            client.username_pw_set("eve", password)
            client.on_connect = lambda _client, _data, _flags, code, _properties: answers.append(not code.is_failure)
            client.loop_start()
            before = len(answers)
            wait_until(lambda before=before: len(answers) > before, 10, "an answer")  # type: ignore[misc]
            client.disconnect()
            client.loop_stop()
    assert answers[0] is False
    assert answers[-1] is True


@pytest.mark.broker
@needs_broker
def test_a_page_that_may_only_look_asks_for_nothing(tmp_path: Path) -> None:
    """The page's own client goes on seeing; what it publishes reaches nobody, and ends its connection."""
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}", "--token-file", str(tmp_path / "token")) as address,
        Subscriber(broker.port) as seen,
    ):
        assert (tmp_path / "token").stat().st_mode & 0o777 == 0o600
        token = address.partition("#")[2]
        assert (tmp_path / "token").read_text() == f"{token}\n"
        viewer = client_through(address.partition("login#")[0])
        viewer.ws_set_options(path="/mqtt", headers=lambda defaults: {**without_origin(defaults), **bearer(token)})
        received: list[bytes] = []
        ended: list[int] = []
        viewer.on_connect = lambda client, *_: client.subscribe("tacshade/#", qos=1)
        viewer.on_subscribe = lambda *_: seen.publish("tacshade/a/state", b"online")
        viewer.on_message = lambda _client, _data, message: received.append(message.payload)
        viewer.on_disconnect = lambda *_: ended.append(1)
        viewer.loop_start()
        wait_until(lambda: received == [b"online"], 10, "the state")
        assert ended == []
        viewer.publish("tacshade/a/req/reference", b"{}", qos=1)
        wait_until(lambda: bool(ended), 10, "closed")
        viewer.loop_stop()
        seen.publish("tacshade/a/state", b"last")
        wait_until(lambda: b"last" in seen.of("tacshade/a/state"), 10, "the last message")
        assert {message.topic for message in seen.messages} == {"tacshade/a/state"}


def without_origin(headers: dict[str, str]) -> dict[str, str]:
    """Paho tells an https origin whatever it connects to."""
    return {name: value for name, value in headers.items() if name != "Origin"}


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}
