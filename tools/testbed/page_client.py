"""A subscriber that connects as a browser does: MQTT over WebSocket, through the dashboard's port."""

from __future__ import annotations

import threading
from types import TracebackType

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from tacshade_edge.protocol import wire
from tacshade_edge.protocol.wire import HeightMessage
from tools.testbed.patience import patience, wait_until


class PageClient:
    """Keeps every message under ``tacshade/#``, in order."""

    def __init__(self, http_port: int) -> None:
        self.messages: list[MQTTMessage] = []
        self._port = http_port
        self._subscribed = threading.Event()
        self.client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5, transport="websockets")
        # Without `self`, as in `mqtt_rig.Subscriber`. paho's own origin says https.
        messages, subscribed = self.messages, self._subscribed
        own = {"Origin": f"http://127.0.0.1:{http_port}"}
        self.client.ws_set_options(path="/mqtt", headers=lambda defaults: {**defaults, **own})
        self.client.on_connect = lambda client, *_: client.subscribe("tacshade/#", qos=1)
        self.client.on_subscribe = lambda *_: subscribed.set()
        self.client.on_message = lambda _client, _data, message: messages.append(message)

    def heights(self) -> list[HeightMessage]:
        """Every height map received so far."""
        decoded = [wire.decode(bytes(m.payload)) for m in list(self.messages) if m.topic.endswith("/height")]
        return [message for message in decoded if isinstance(message, HeightMessage)]

    def wait_for_heights(self, count: int, timeout_s: float) -> list[HeightMessage]:
        wait_until(lambda: len(self.heights()) >= count, timeout_s, f"{count} height maps")
        return self.heights()

    def __enter__(self) -> PageClient:
        self.client.connect("127.0.0.1", self._port)
        self.client.loop_start()
        assert self._subscribed.wait(patience(10))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.client.disconnect()
        self.client.loop_stop()
