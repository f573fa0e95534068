"""A viewer that reads nothing: what waits for it is bounded, in messages and bytes, and the newest wins."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from support.patience import wait_until

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
    with client.connect(url, subprotocols=["foxglove.sdk.v1"], max_queue=1, max_size=None) as viewer:
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
