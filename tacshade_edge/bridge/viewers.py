"""Foxglove's WebSocket protocol with limits on the number of viewers and on what waits
for a slow one.

Only the SDK's encoders are used, not its server (as of foxglove-sdk 0.30.3): it accepts any number
of connections, and once the process has no file descriptor left it stops listening, for good and
without a word; `stop` does not return while a connection is silent or a viewer reads nothing; and
what waits for a viewer is bounded in messages, which may have megabytes each, not in bytes.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import itertools
import json
import logging
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import foxglove
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from tacshade_edge.errors import DecodeError
from tacshade_edge.listening_socket import Connections, ListeningSocket
from tacshade_edge.wire.codec import decode_object

_log = logging.getLogger(__name__)

VIEWERS_MAX: Final = 16
# More than viewers: some have not spoken yet, others are being told why they are turned away.
CONNECTIONS_MAX: Final = 48
# Below WAITING_BYTES_MAX: a larger message would push itself out of the queue.
MESSAGE_BYTES_MAX: Final = 5 << 20
WAITING_BYTES_MAX: Final = 8 << 20
WAITING_MAX: Final = 256
"""Limits on what waits for one viewer, besides the message being sent;
the oldest messages are dropped.
"""
# Pongs do not wait in the queue: only the transport's buffer shows them.
_UNSENT_BYTES_MAX: Final = 2 * MESSAGE_BYTES_MAX
# Enough to subscribe to every channel of every sensor at once.
_FROM_VIEWER_BYTES_MAX: Final = 1 << 16
# A viewer that reads nothing keeps its sensors computing until it is disconnected, _STALL_S later.
_SPEAK_S, _STALL_S, _CLOSE_S, _START_S = 5.0, 10.0, 0.5, 10.0
_PROTOCOLS: Final = [Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1")]
_MESSAGE: Final = struct.Struct("<BIQ")
# WebSocket's close code "try again later".
_TRY_AGAIN: Final = 1013
_SERVER_INFO: Final = json.dumps(
    {"op": "serverInfo", "name": "tacshade-edge", "capabilities": [], "metadata": {}}
)

Schema: TypeAlias = foxglove.Schema | dict[str, Any]
"""The SDK's schema, or a JSON Schema with a title."""


@dataclass(slots=True, eq=False)
class Viewer:
    """A connected viewer: what it subscribed to, and what waits for it."""

    socket: ServerConnection
    wake: asyncio.Event = field(default_factory=asyncio.Event)
    # From channel to the viewer's own number.
    subscriptions: dict[int, int] = field(default_factory=dict)
    waiting: deque[str | bytes] = field(default_factory=deque)
    waiting_bytes: int = 0
    missed: int = 0

    def put(self, message: str | bytes) -> None:
        """Queue a message and drop the oldest ones over the limits;
        without a text, a viewer cannot go on.
        """
        self.waiting.append(message)
        self.waiting_bytes += len(message)
        while len(self.waiting) > WAITING_MAX or self.waiting_bytes > WAITING_BYTES_MAX:
            if isinstance(self.take(), str):
                self.socket.transport.abort()
            self.missed += 1
        self.wake.set()

    def take(self) -> str | bytes:
        message = self.waiting.popleft()
        self.waiting_bytes -= len(message)
        return message


class _Connection(ServerConnection):
    """A connection that closes when its client keeps sending pings without reading the pongs."""

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.transport.get_write_buffer_size() > _UNSENT_BYTES_MAX:
            self.transport.abort()


class Viewers:
    """Serves channels to viewers in its own thread, where `on_change` is called. Raises OSError."""

    def __init__(self, host: str, port: int, on_change: Callable[[], None]) -> None:
        self._on_change = on_change
        self._numbers = itertools.count()
        # As the protocol's `advertise` describes them.
        self._channels: dict[int, dict[str, Any]] = {}
        self._viewers: list[Viewer] = []
        self.missed = 0
        self._listener = ListeningSocket(host, port, Connections(CONNECTIONS_MAX).admit)
        self.port: int = self._listener.getsockname()[1]
        self._loop = asyncio.new_event_loop()
        self._over = asyncio.Event()
        listening = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(listening,), name="viewers")
        self._thread.start()
        listening.wait(_START_S)

    def stop(self) -> None:
        """Close the viewers' connections, even if they do not respond."""
        self._soon(self._over.set)
        self._thread.join()

    def advertise(self, schemas: dict[str, Schema]) -> list[int]:
        """Offer a channel for each topic and return the channels' numbers."""
        channels = [_described(next(self._numbers), *each) for each in schemas.items()]
        numbers = [int(channel["id"]) for channel in channels]
        self._soon(self._offer, dict(zip(numbers, channels, strict=True)))
        return numbers

    def withdraw(self, numbers: Sequence[int]) -> None:
        self._soon(self._remove, numbers)

    def watched(self, number: int) -> bool:
        """Whether anybody watches a channel."""
        return any(number in viewer.subscriptions for viewer in self.viewers())

    def viewers(self) -> tuple[Viewer, ...]:
        """Return who is connected now."""
        # A copy: the server's thread changes the list meanwhile.
        return tuple(self._viewers)

    def send(self, number: int, payload: bytes) -> None:
        self._soon(self._queue, number, time.time_ns(), payload)

    def _soon(self, job: Callable[..., object], *args: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(job, *args)

    # -- in the thread of the server ---------------------------------------------------------------

    def _offer(self, channels: dict[int, dict[str, Any]]) -> None:
        self._channels |= channels
        for viewer in self._viewers:
            viewer.put(_advertisement(channels))

    def _remove(self, numbers: Sequence[int]) -> None:
        for number in numbers:
            del self._channels[number]
        for viewer in self._viewers:
            for number in numbers:
                viewer.subscriptions.pop(number, None)
            viewer.put(json.dumps({"op": "unadvertise", "channelIds": list(numbers)}))

    def _queue(self, number: int, log_ns: int, payload: bytes) -> None:
        for viewer in self._viewers:
            if (subscription := viewer.subscriptions.get(number)) is not None:
                viewer.put(_MESSAGE.pack(1, subscription, log_ns) + payload)

    def _run(self, listening: threading.Event) -> None:
        # Each connection of a port scanner would log a traceback.
        quiet = logging.getLogger("websockets.server.viewers")
        quiet.setLevel(logging.CRITICAL)
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve(listening, quiet))

    async def _serve(self, listening: threading.Event, quiet: logging.Logger) -> None:
        server = await serve(
            self._carry,
            sock=self._listener,
            create_connection=_Connection,
            subprotocols=_PROTOCOLS,
            # Deflating a map would cost more time, and memory per viewer, than a network saves.
            compression=None,
            max_size=_FROM_VIEWER_BYTES_MAX,
            max_queue=4,
            open_timeout=_SPEAK_S,
            close_timeout=_CLOSE_S,
            server_header=None,
            logger=quiet,
        )
        listening.set()
        await self._over.wait()
        server.close()
        # A silent connection would hold this up until its open timeout.
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(server.wait_closed(), 2 * _CLOSE_S)

    async def _carry(self, socket: ServerConnection) -> None:
        if len(self._viewers) >= VIEWERS_MAX:
            _log.warning(
                "turned a viewer away: %d viewers, the maximum, are already connected", VIEWERS_MAX
            )
            await socket.close(
                _TRY_AGAIN, f"{VIEWERS_MAX} viewers, the maximum, are already connected"
            )
            return
        viewer = Viewer(socket)
        viewer.put(_SERVER_INFO)
        viewer.put(_advertisement(self._channels))
        self._viewers.append(viewer)
        sending = asyncio.ensure_future(_send_all(viewer))
        try:
            async for message in socket:
                self._hear(viewer, message)
        except ConnectionClosed:
            pass
        finally:
            self._viewers.remove(viewer)
            self.missed += viewer.missed
            sending.cancel()
            if viewer.missed:
                _log.info(
                    "a viewer that read too slowly missed %d messages before it left", viewer.missed
                )
            self._on_change()

    def _hear(self, viewer: Viewer, message: str | bytes) -> None:
        """Process a viewer's request; if it is malformed, report that to the viewer."""
        try:
            wanted = decode_object("viewer", message.encode() if isinstance(message, str) else b"")
        except DecodeError as error:
            viewer.put(_status(f"Invalid message: {error}"))
            return
        match wanted:
            case {"op": "subscribe", "subscriptions": list(subscriptions)}:
                for subscription in subscriptions:
                    self._subscribe(viewer, subscription)
            case {"op": "unsubscribe", "subscriptionIds": list(ids)}:
                viewer.subscriptions = {
                    c: own for c, own in viewer.subscriptions.items() if own not in ids
                }
        self._on_change()

    def _subscribe(self, viewer: Viewer, subscription: Any) -> None:
        match subscription:
            case {"id": int(own), "channelId": int(channel)} if (
                0 <= own < 2**32 and channel in self._channels
            ):
                if own not in viewer.subscriptions.values():
                    viewer.subscriptions.setdefault(channel, own)
            case {"channelId": int(channel)}:
                viewer.put(_status(f"Unknown channel ID: {channel}"))


async def _send_all(viewer: Viewer) -> None:
    """Send a viewer's messages; only this waits for a slow viewer,
    and it disconnects one that reads nothing.
    """
    with contextlib.suppress(ConnectionClosed):
        while await viewer.wake.wait():
            viewer.wake.clear()
            while viewer.waiting:
                try:
                    async with asyncio.timeout(_STALL_S):
                        await viewer.socket.send(viewer.take())
                except TimeoutError:
                    _log.warning("disconnected a viewer that read nothing for %.0f s", _STALL_S)
                    viewer.socket.transport.abort()
                    return


def _described(number: int, topic: str, schema: Schema) -> dict[str, Any]:
    if isinstance(schema, dict):
        words = ("json", schema["title"], "jsonschema", json.dumps(schema))
    else:
        words = (
            schema.encoding,
            schema.name,
            schema.encoding,
            base64.b64encode(schema.data).decode(),
        )
    keys = ("encoding", "schemaName", "schemaEncoding", "schema")
    return {"id": number, "topic": topic, **dict(zip(keys, words, strict=True))}


def _advertisement(channels: dict[int, dict[str, Any]]) -> str:
    return json.dumps({"op": "advertise", "channels": list(channels.values())})


def _status(message: str) -> str:
    return json.dumps({"op": "status", "level": 2, "message": message})
