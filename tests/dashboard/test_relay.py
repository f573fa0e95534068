"""The bytes between a page and the broker, through the server; real sockets."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion
from websockets.exceptions import ConnectionClosed

from support.dashboard_process import dashboard
from support.mqtt_rig import Broker
from support.page_server import client_through, echo, get, running, tcp, websocket
from support.patience import wait_until
from tacshade_edge.dashboard import relay


@pytest.mark.parametrize(("message", "code"), [("text", 1003), (b"x" * (1 << 17), 1009)])
async def test_what_is_no_mqtt_is_refused(message: str | bytes, code: int) -> None:
    async with tcp(echo) as broker, running(broker) as port, websocket(port) as page:
        await page.send(message)
        with pytest.raises(ConnectionClosed) as closed:
            await page.recv()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == code


async def test_a_broker_that_is_away_is_reported_and_tried_again() -> None:
    async def reason(port: int) -> str:
        async with websocket(port) as page:
            with pytest.raises(ConnectionClosed) as closed:
                await page.recv()
            assert closed.value.rcvd is not None
            assert closed.value.rcvd.code == 1013
            return closed.value.rcvd.reason

    async def hang_up(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.close()

    async with tcp(echo) as broker:
        pass
    async with running(broker) as port:
        assert await reason(port) == f"broker 127.0.0.1:{broker}: connection refused"
        listener = await asyncio.start_server(hang_up, "127.0.0.1", broker)
        async with listener:
            assert await reason(port) == f"broker 127.0.0.1:{broker} closed the connection"
        assert (await get(port, "/"))[0] == 200


async def test_a_page_that_goes_away_leaves_no_connection_at_the_broker() -> None:
    ended = asyncio.Event()

    async def until_end(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read()
        ended.set()
        writer.close()

    async with tcp(until_end) as broker, running(broker) as port:
        async with websocket(port) as page:
            await page.send(b"hello")
            page.transport.abort()  # no closing frame: a tab that crashed
        await ended.wait()


async def test_a_page_that_reads_nothing_is_closed_at_the_broker_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(relay, "STALL_S", 0.3)
    ended = asyncio.Event()

    async def flood(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                writer.write(bytes(65536))
                await writer.drain()
        except ConnectionError:
            ended.set()

    async with tcp(flood) as broker, running(broker) as port:
        page = await websocket(port, max_queue=1).__aenter__()
        await ended.wait()
        page.transport.abort()


@pytest.mark.broker
def test_height_maps_of_full_size_come_through_mosquitto_over_tls(tmp_path: Path) -> None:
    payload = bytes(range(256)) * 2400  # 614 KB, as 640x480 cells
    received: list[bytes] = []
    with (
        Broker(tmp_path, tls=True) as broker,
        dashboard(f"127.0.0.1:{broker.port}", "--ca-file", str(broker.ca)) as address,
    ):
        reader, writer = client_through(address), Client(CallbackAPIVersion.VERSION2)
        reader.on_connect = lambda client, *_: client.subscribe("height")
        reader.on_subscribe = lambda *_: writer.loop_start()
        reader.on_message = lambda _client, _data, message: received.append(message.payload)
        writer.on_connect = lambda client, *_: [
            client.publish("height", payload) for _ in range(10)
        ]
        writer.tls_set(ca_certs=str(broker.ca))
        writer.connect_async("127.0.0.1", broker.port)
        reader.loop_start()
        wait_until(lambda: len(received) == 10, 20, "ten maps")
        for client in (reader, writer):
            client.disconnect()
            client.loop_stop()
    assert set(received) == {payload}
