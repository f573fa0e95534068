"""A viewer that reads nothing: what waits for it is bounded, in messages and bytes, and the newest wins."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from tools.testbed.patience import wait_until

pytest.importorskip("foxglove", reason="the extra foxglove is not installed")
client = pytest.importorskip("websockets.sync.client", reason="the extra dashboard is not installed")
viewers = pytest.importorskip("tacshade_edge.bridge.viewers")

SCHEMA = {"title": "t.T", "type": "object"}


@pytest.fixture
def server() -> Iterator[Any]:
    made = viewers.Viewers("127.0.0.1", 0, lambda: None)
    yield made
    made.stop()


@contextmanager
def watching(server: Any, *channels: int) -> Iterator[Any]:
    url = f"ws://127.0.0.1:{server.port}"
    words = {"subprotocols": ["foxglove.sdk.v1"], "max_queue": 1, "max_size": None, "close_timeout": 0.2}
    with client.connect(url, **words) as viewer:
        subscribe(server, viewer, *channels)
        yield viewer


def subscribe(server: Any, viewer: Any, *channels: int) -> None:
    wanted = ", ".join(f'{{"id": {channel}, "channelId": {channel}}}' for channel in channels)
    viewer.send(f'{{"op": "subscribe", "subscriptions": [{wanted}]}}')
    wait_until(lambda: all(server.watched(channel) for channel in channels), 10, "watched")


def test_of_many_channels_no_more_bytes_wait_than_of_one(server: Any) -> None:
    numbers = server.advertise([viewers.Channel(f"/{n}", SCHEMA, 64) for n in range(10)])
    with watching(server, *numbers):
        for number in numbers * 10:
            server.send(number, bytes(1 << 20))
        (one,) = server._viewers
        assert one.waiting_bytes <= viewers.WAITING_BYTES_MAX
        assert sum(len(payload) for queue in one.waiting.values() for _, payload in queue) == one.waiting_bytes


def test_one_that_reads_nothing_loses_counted_messages_and_no_other_does(
    server: Any, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, logger="tacshade_edge.bridge.viewers")
    names = (("/pictures", 1), ("/lines", 64), ("/others", 1))
    pictures, lines, others = server.advertise([viewers.Channel(name, SCHEMA, depth) for name, depth in names])
    with watching(server, pictures, lines) as slow:
        for number in range(200):
            server.send(pictures, number.to_bytes(4, "little") + bytes(1 << 20))
            server.send(lines, b"{}")
        (one,), newest = server._viewers, 0
        waits = {key[0]: len(queue) for key, queue in one.waiting.items()}
        assert waits.get(pictures, 0) <= 1
        assert waits.get(lines, 0) <= 64
        assert one.passed_over > 100  # what the kernel's buffers took was sent
        with watching(server, others) as other:
            server.send(others, b"{}")
            while not isinstance(other.recv(timeout=10), bytes):
                pass
        for _ in range(400 - one.passed_over):  # the rest comes, the newest last of its channel
            while not isinstance(message := slow.recv(timeout=10), bytes):
                pass
            newest = int.from_bytes(message[13:17], "little") if len(message) > 1 << 20 else newest
        assert newest == 199
        passed_over = one.passed_over
    wait_until(lambda: server.passed_over == passed_over, 10, "counted")
    wait_until(lambda: "a viewer that read too slowly missed" in caplog.text, 10, "logged")
