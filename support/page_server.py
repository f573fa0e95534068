"""The dashboard's server in this process, and what talks to it byte by byte."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

from support.patience import patience
from tacshade_edge.dashboard import server
from tacshade_edge.dashboard.relay import Broker as Address

Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]
TOKEN = "a-token-of-this-test"


def run(test: Coroutine[Any, Any, None]) -> None:
    async def limited() -> None:
        async with asyncio.timeout(patience(30)):
            await test

    asyncio.run(limited())


@asynccontextmanager
async def running(
    broker_port: int = 1,
    origins: frozenset[str] = frozenset(),
    host: str = "127.0.0.1",
    **access: Any,
) -> AsyncIterator[int]:
    """The server in this process; its port."""
    port: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    stop = asyncio.Event()
    serving = asyncio.create_task(
        server.run(
            Address(host, broker_port),
            "127.0.0.1",
            0,
            origins,
            lambda _host, p: port.set_result(p),
            stop,
            **access,
        )
    )
    yield await port
    stop.set()
    await serving


@asynccontextmanager
async def tcp(serve: Serve) -> AsyncIterator[int]:
    """A TCP server in the place of the broker."""
    listener = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with listener:
        yield int(listener.sockets[0].getsockname()[1])


def websocket(port: int, **words: Any) -> connect:
    return connect(
        f"ws://127.0.0.1:{port}/mqtt",
        subprotocols=[Subprotocol("mqtt")],
        compression=None,
        max_size=None,
        **words,
    )


async def get(port: int, path: str, *headers: str) -> tuple[int, dict[str, str], bytes]:
    """A request exactly as written: no client tidies the path."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    lines = [f"GET {path} HTTP/1.1", f"Host: 127.0.0.1:{port}", *headers]
    writer.write("\r\n".join([*lines, "", ""]).encode())
    head, _, body = (await reader.read()).partition(b"\r\n\r\n")
    writer.close()
    status, *fields = head.decode().split("\r\n")
    return (
        int(status.split()[1]),
        {k.lower(): v for k, v in (f.split(": ", 1) for f in fields)},
        body,
    )


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


async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while chunk := await reader.read(65536):
        writer.write(chunk)
        await writer.drain()
    writer.close()


def client_through(address: str) -> Client:
    """Paho over WebSocket, through the dashboard's server."""
    host, port = address.removeprefix("http://").rstrip("/").rsplit(":", 1)
    client = Client(CallbackAPIVersion.VERSION2, transport="websockets")
    client.ws_set_options(path="/mqtt")
    client.connect_async(host, int(port))
    return client
