"""Foxglove's WebSocket protocol with limits on the number of viewers and on the bytes that wait for a slow one.

The SDK's own server limits the number of waiting messages, not their bytes, accepts any number of connections, and
waits for silent ones when it stops; so only the SDK's encoders are used.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import logging
import struct
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import foxglove
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from tacshade_edge.devices.listener import Connections, Listener
from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.codec import decode_object

_log = logging.getLogger(__name__)

VIEWERS_MAX: Final = 16
CONNECTIONS_MAX: Final = 48
MESSAGE_BYTES_MAX: Final = 5 << 20
WAITING_BYTES_MAX: Final = 8 << 20
"""Limit on what waits for one viewer, besides the message being sent; the oldest messages are dropped."""
_TEXTS_MAX: Final = 256
_UNSENT_BYTES_MAX: Final = 2 * MESSAGE_BYTES_MAX
_FROM_VIEWER_BYTES_MAX: Final = 1 << 16
_SPEAK_S: Final = 5.0
_STALL_S: Final = 10.0
_CLOSE_S: Final = 0.5
_START_S: Final = 10.0
_PROTOCOLS: Final = [Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1")]
_MESSAGE: Final = struct.Struct("<BIQ")
_TRY_AGAIN: Final = 1013  # WebSocket close code "try again later"


@dataclass(frozen=True, slots=True)
class Channel:
    """A stream of messages that a viewer can subscribe to, with the SDK's schema or a JSON Schema with a title.

    Of its messages, `depth` wait for a busy viewer; newer ones replace older ones.
    """

    topic: str
    schema: foxglove.Schema | dict[str, Any]
    depth: int = 1

    def advertised(self, number: int) -> dict[str, Any]:
        """The channel as the protocol's `advertise` describes it."""
        schema = self.schema
        if isinstance(schema, dict):
            words = ("json", schema["title"], "jsonschema", json.dumps(schema))
        else:
            words = (schema.encoding, schema.name, schema.encoding, base64.b64encode(schema.data).decode())
        encoding, name, schema_encoding, text = words
        described = {"encoding": encoding, "schemaName": name, "schemaEncoding": schema_encoding, "schema": text}
        return {"id": number, "topic": self.topic, **described}


@dataclass(slots=True, eq=False)
class _Viewer:
    socket: ServerConnection
    wake: asyncio.Event = field(default_factory=asyncio.Event)
    texts: deque[str] = field(default_factory=deque)
    channels: dict[int, int] = field(default_factory=dict)
    """The viewer's subscription number for each channel that it watches."""
    waiting: OrderedDict[tuple[int, str], deque[tuple[int, bytes]]] = field(default_factory=OrderedDict)
    waiting_bytes: int = 0
    passed_over: int = 0
    """Number of messages that newer ones replaced before they were sent."""

    def put(self, channel: int, slot: str, depth: int, log_ns: int, payload: bytes) -> None:
        """Queue a message, dropping older ones that exceed `depth` or `WAITING_BYTES_MAX`."""
        queue = self.waiting.setdefault((channel, slot), deque())
        queue.append((log_ns, payload))
        self.waiting_bytes += len(payload)
        while len(queue) > depth:
            self.waiting_bytes -= len(queue.popleft()[1])
            self.passed_over += 1
        while self.waiting_bytes > WAITING_BYTES_MAX:
            self._pop()
            self.passed_over += 1

    def take(self) -> str | bytes | None:
        """Return the next message to send, or None if nothing waits."""
        if self.texts:
            return self.texts.popleft()
        while self.waiting:
            channel, (log_ns, payload) = self._pop()
            if (subscription := self.channels.get(channel)) is not None:
                return _MESSAGE.pack(1, subscription, log_ns) + payload
        return None

    def _pop(self) -> tuple[int, tuple[int, bytes]]:
        """Remove and return the oldest message of the channel whose turn it is."""
        key, queue = self.waiting.popitem(last=False)
        message = queue.popleft()
        self.waiting_bytes -= len(message[1])
        if queue:
            self.waiting[key] = queue
        return key[0], message


class _Connection(ServerConnection):
    """A connection that closes when its client keeps sending pings without reading the pongs."""

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.transport.get_write_buffer_size() > _UNSENT_BYTES_MAX:
            self.transport.abort()


class Viewers:
    """Serves channels to viewers in its own thread; `on_change` is called there when one starts or stops watching.

    `passed_over` counts the messages that former viewers were too slow to receive. Raises OSError.
    """

    def __init__(self, host: str, port: int, on_change: Callable[[], None]) -> None:
        self._on_change = on_change
        self._lock = threading.Lock()
        self._channels: dict[int, Channel] = {}
        self._number = 0
        self._viewers: list[_Viewer] = []
        self.passed_over = 0
        self._listener = Listener(host, port, Connections(CONNECTIONS_MAX).admit)
        self.port: int = self._listener.getsockname()[1]
        self._loop = asyncio.new_event_loop()
        self._over = asyncio.Event()
        listening = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(listening,), name="viewers")
        self._thread.start()
        listening.wait(_START_S)

    def stop(self) -> None:
        """Close the viewers' connections, even if they do not respond."""
        self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join()

    def advertise(self, channels: Sequence[Channel]) -> list[int]:
        """Offer channels to the viewers and return the channels' numbers."""
        with self._lock:
            numbers = list(range(self._number, self._number + len(channels)))
            self._number += len(channels)
            self._channels.update(zip(numbers, channels, strict=True))
            self._notify_all(self._advertisement(numbers))
        return numbers

    def withdraw(self, numbers: Sequence[int]) -> None:
        """Stop offering these channels."""
        with self._lock:
            for number in numbers:
                del self._channels[number]
                for viewer in self._viewers:
                    viewer.channels.pop(number, None)
            self._notify_all(json.dumps({"op": "unadvertise", "channelIds": list(numbers)}))

    def watched(self, number: int) -> bool:
        """Whether anybody watches a channel."""
        with self._lock:
            return any(number in viewer.channels for viewer in self._viewers)

    def send(self, number: int, payload: bytes, slot: str = "") -> None:
        """Queue a message for all viewers of a channel; each slot of a channel keeps its newest `depth` messages."""
        log_ns = time.time_ns()
        with self._lock:
            depth = self._channels[number].depth
            for viewer in self._viewers:
                if number in viewer.channels:
                    viewer.put(number, slot, depth, log_ns, payload)
                    self._wake(viewer)

    def _advertisement(self, numbers: Sequence[int]) -> str:
        return json.dumps(
            {"op": "advertise", "channels": [self._channels[number].advertised(number) for number in numbers]}
        )

    def _notify_all(self, text: str) -> None:
        for viewer in self._viewers:
            self._notify(viewer, text)

    def _notify(self, viewer: _Viewer, text: str) -> None:
        if len(viewer.texts) >= _TEXTS_MAX:
            self._loop.call_soon_threadsafe(viewer.socket.transport.abort)
            return
        viewer.texts.append(text)
        self._wake(viewer)

    def _wake(self, viewer: _Viewer) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(viewer.wake.set)

    # -- in the thread of the server --------------------------------------------------------------------------------

    def _run(self, listening: threading.Event) -> None:
        quiet = logging.getLogger("websockets.server.viewers")
        quiet.setLevel(logging.CRITICAL)  # each connection of a port scanner would log a traceback
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve(listening, quiet))

    async def _serve(self, listening: threading.Event, quiet: logging.Logger) -> None:
        server = await serve(
            self._carry,
            sock=self._listener,
            create_connection=_Connection,
            subprotocols=_PROTOCOLS,
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
        viewer = _Viewer(socket)
        with self._lock:
            full = len(self._viewers) >= VIEWERS_MAX
            if not full:
                viewer.texts.append(_SERVER_INFO)
                viewer.texts.append(self._advertisement(list(self._channels)))
                viewer.wake.set()
                self._viewers.append(viewer)
        if full:
            _log.warning("turned a viewer away: %d viewers, the maximum, are already connected", VIEWERS_MAX)
            await socket.close(_TRY_AGAIN, f"{VIEWERS_MAX} viewers, the maximum, are already connected")
            return
        sending = asyncio.ensure_future(self._send_all(viewer))
        try:
            async for message in socket:
                self._hear(viewer, message)
        except ConnectionClosed:
            pass
        finally:
            with self._lock:
                self._viewers.remove(viewer)
                self.passed_over += viewer.passed_over
            sending.cancel()
            if viewer.passed_over:
                _log.info("a viewer that read too slowly missed %d messages before it left", viewer.passed_over)
            self._on_change()

    async def _send_all(self, viewer: _Viewer) -> None:
        """Send a viewer's messages; only this waits for a slow viewer, and it disconnects one that reads nothing."""
        with contextlib.suppress(ConnectionClosed):
            while await viewer.wake.wait():
                viewer.wake.clear()
                while (message := self._next(viewer)) is not None:
                    try:
                        async with asyncio.timeout(_STALL_S):
                            await viewer.socket.send(message)
                    except TimeoutError:
                        _log.warning("disconnected a viewer that read nothing for %.0f s", _STALL_S)
                        viewer.socket.transport.abort()
                        return

    def _next(self, viewer: _Viewer) -> str | bytes | None:
        with self._lock:
            return viewer.take()

    def _hear(self, viewer: _Viewer, message: str | bytes) -> None:
        """Process a viewer's request; if it is malformed, report that to the viewer."""
        try:
            wanted = decode_object("viewer", message.encode() if isinstance(message, str) else b"")
        except DecodeError as error:
            self._refuse(viewer, str(error))
            return
        with self._lock:
            match wanted:
                case {"op": "subscribe", "subscriptions": list(subscriptions)}:
                    for subscription in subscriptions:
                        self._subscribe(viewer, subscription)
                case {"op": "unsubscribe", "subscriptionIds": list(ids)}:
                    viewer.channels = {c: number for c, number in viewer.channels.items() if number not in ids}
        self._on_change()

    def _subscribe(self, viewer: _Viewer, subscription: Any) -> None:
        match subscription:
            case {"id": int(number), "channelId": int(channel)} if 0 <= number < 2**32 and channel in self._channels:
                if number not in viewer.channels.values():
                    viewer.channels.setdefault(channel, number)
            case {"channelId": int(channel)}:
                self._notify(viewer, _status(f"Unknown channel ID: {channel}"))

    def _refuse(self, viewer: _Viewer, why: str) -> None:
        with self._lock:
            self._notify(viewer, _status(f"Invalid message: {why}"))


def _status(message: str) -> str:
    return json.dumps({"op": "status", "level": 2, "message": message})


_SERVER_INFO: Final = json.dumps({"op": "serverInfo", "name": "tacshade-edge", "capabilities": [], "metadata": {}})
