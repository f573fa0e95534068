"""The connection to the MQTT broker, which reconnects by itself; `Outgoing` handles what it sends."""

from __future__ import annotations

import json
import logging
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode as MqttCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from tacshade_edge.devices.fixes import BROKERS_LOG, connect_fix, no_answer_fix, refusal_fix, with_fix
from tacshade_edge.devices.mqtt.client import (
    BrokerAddress,
    connect,
    connect_failure,
    make_client,
    packet_bytes_max,
    publish_properties,
)
from tacshade_edge.devices.mqtt.client_id_guard import ClientIdGuard, new_instance
from tacshade_edge.devices.mqtt.outgoing import CONTENT_TYPES, Outgoing
from tacshade_edge.devices.mqtt.topic_slot import Item, PayloadOutcome
from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.requests import Request, encode_error, parse_request, parse_transaction
from tacshade_edge.reasons import Reason, ReasonCode


@dataclass(frozen=True, slots=True)
class BadRequest:
    """A rejected request. `topic`: topic for `answer`, below the base topic; None if it cannot be answered."""

    topic: str | None
    answer: bytes
    correlation: bytes | None


def read_request(base_topic: str, topic: str, message: MQTTMessage) -> Request | BadRequest:
    """Parse a message on ``req/<verb>``."""
    verb = topic.removeprefix(f"{base_topic}/req/")
    payload = bytes(message.payload)
    asked = str(getattr(message.properties, "ResponseTopic", None) or "")
    correlation = getattr(message.properties, "CorrelationData", None)
    # Only below res/: a client must not be able to make this daemon publish in the name of a hand.
    below = asked.removeprefix(f"{base_topic}/")
    sound = below != asked and len(below) > len("res/") and _may_name_a_topic(asked)
    response_topic = below if sound and below.startswith("res/") else None
    try:
        return parse_request(verb, payload, response_topic=response_topic, correlation=correlation)
    except DecodeError as error:
        answer_on = response_topic or (f"res/{verb}" if _may_name_a_topic(verb) else None)
        return BadRequest(answer_on, encode_error(parse_transaction(payload), error.reason), correlation)


def _may_name_a_topic(text: str) -> bool:
    """Whether this may be published on: a broker ends the connection for a control character, paho raises for others.

    U+FFFD is what was not UTF-8, and longer.
    """
    return text.isprintable() and not set(text) & set("+#\ufffd")


_log = logging.getLogger(__name__)


class MqttLink(Outgoing):
    """A connection that publishes streams, retained values and replies, and receives requests.

    `base_topic`: ``tacshade/<sensor-id>``, without a slash at either end. `client_id`: fixed per sensor: a new
    connection must take over from a dead one, including its will. It does not take over from a live one: while another
    daemon uses the sensor's name, this one waits. `tls_ca`: PEM file of the authority that signed the broker's
    certificate; None disables TLS. `on_request`, `on_outcome`: called from paho's network thread or from the caller of
    `offer`; they must only count or enqueue. `on_outcome` receives (stream, seq, outcome) once per offered payload.
    Raises ConfigError (a host name, topic or authority file that can never work).
    """

    def __init__(
        self,
        *,
        host: str,
        port: int,
        base_topic: str,
        client_id: str,
        username: str | None = None,
        password: str | None = None,
        tls_ca: str | None = None,
        on_request: Callable[[Request], None],
        on_outcome: Callable[[str, int, PayloadOutcome], None],
    ) -> None:
        instance = new_instance()
        broker = BrokerAddress(host=host, port=port, username=username, password=password, tls_ca=tls_ca)
        client, asking = (make_client(broker, base_topic=base_topic, client_id=name) for name in (client_id, ""))
        super().__init__(client, f"{host}:{port}", base_topic, on_outcome)
        self._host, self._port, self._username, self._tls_ca = host, port, username, tls_ca
        self._on_request = on_request
        self._refused = False
        self._reason: Reason | None = self._with_address(ReasonCode.STARTING, "not started")
        self._watched: dict[str, Callable[[bytes], None]] = {}
        self._thread: threading.Thread | None = None
        self._holder = ClientIdGuard(asking, host, port, base_topic, instance)
        will = publish_properties(CONTENT_TYPES["state"], of_will=True)
        client.will_set(f"{base_topic}/state", b"offline", qos=1, retain=True, properties=will)
        client.on_pre_connect = self._on_pre_connect
        client.on_connect = self._on_connect
        client.on_connect_fail = self._on_connect_fail
        client.on_disconnect = self._on_disconnect
        client.on_subscribe = self._on_subscribe
        client.receive(self._on_message)
        self.set_retained("state", b"online")
        self.set_retained("instance", json.dumps(instance).encode())

    @property
    def reason(self) -> Reason | None:
        """The reason why the link is not connected; None when it is."""
        return self._reason

    def start(self) -> None:
        """Start connecting, and keep trying until `stop`; an absent broker is no error. Call once."""
        self._set_reason(self._with_address(ReasonCode.STARTING, "connecting"))
        connect(self._client, self._host, self._port)

    def stop(self, timeout_s: float) -> None:
        """Publish what waits and ``state`` = ``stopped``, and disconnect; always return within `timeout_s`.

        A broker that does not accept that in time publishes the last will, ``offline``, instead.
        Every payload not sent by then has failed.
        """
        begin = time.monotonic()
        with self._lock:
            streams = [o for o in self._outlets.values() if not o.retain]
            for outlet in streams:
                outlet.most += 1  # the last payload of each stream precedes the state
        for outlet in streams:
            self._pump(outlet)
        self.set_retained("state", b"stopped")
        state = self._outlets["state"]
        with self._lock:
            self._changed.wait_for(lambda: state.idle or not self._connected, 0.6 * timeout_s)
            self._stopping = True
        self._client.disconnect()
        with self._lock:
            self._changed.wait_for(lambda: not self._connected, begin + 0.8 * timeout_s - time.monotonic())
        self._end_thread(begin + timeout_s)
        with self._lock:
            left = self._lose(None) + [(o.topic, i) for o in streams for i in o.drain()]
        self._settle("failed", left)

    def watch(self, topic: str, on_payload: Callable[[bytes], None]) -> None:
        """Subscribe to a topic below the base on every connection, retained value included; call before `start`.

        `on_payload` is called like `on_request`, but not for what this link itself publishes there. If it raises
        DecodeError, that is a bad request.
        """
        self._watched[topic] = on_payload

    def _lose(self, reason: Reason | None, code: int | None = None) -> list[tuple[str, Item]]:
        """Record the loss of the connection; return the items that failed with it. Lock held."""
        if self._stopping:
            self._set_reason(self._with_address(ReasonCode.STOPPED, "stopped"))
        else:
            self._set_reason(reason, BROKERS_LOG)
        return self._forget(code)

    def _with_address(self, code: ReasonCode, text: str) -> Reason:
        return Reason(code, f"{self._where}: {text}")

    def _set_reason(self, reason: Reason | None, fix: str = "") -> None:
        """Store why we are not connected; log a change, not a repetition. A reason with a fix is a fault."""
        if reason == self._reason:
            return
        self._reason = reason
        if reason and fix:
            _log.warning("%s", with_fix(reason, fix))
        else:
            _log.info("%s", reason or f"{self._where}: connected")

    def _end_thread(self, deadline: float) -> None:
        """Wait for paho's thread; leave one that hangs in a connection attempt, since it is a daemon thread."""
        sock = self._client.socket()
        if sock is not None:
            try:
                sock.shutdown(socket.SHUT_RDWR)  # type: ignore[attr-defined]
            except OSError:
                _log.debug("the socket was already closed")
        if self._thread is not None:
            self._thread.join(max(0.0, deadline - time.monotonic()))

    # -- called by paho, in its thread ----------------------------------------------------------------------------

    def _on_pre_connect(self, _client: Client, _userdata: Any) -> None:
        self._thread, self._refused = threading.current_thread(), False
        if self._connected:  # paho can lose a connection without calling on_disconnect
            self._drop(self._with_address(ReasonCode.LOST, "connection lost"))
        self._holder.wait_until_gone(self._report_holder, lambda: self._stopping)
        if self._stopping:
            raise ConnectionAbortedError("stopped")

    def _report_holder(self, reason: Reason) -> None:
        if reason != self._reason:
            _log.warning("%s; waiting for the other daemon to stop", reason)
        with self._lock:
            self._reason = reason

    def _on_connect(
        self, client: Client, _userdata: Any, _flags: Any, code: MqttCode, properties: Properties | None
    ) -> None:
        if code.is_failure:
            with self._lock:
                self._refused = True
                self._set_reason(
                    self._with_address(ReasonCode.REFUSED, f"rejects the connection: {code}"),
                    refusal_fix(code.value, self._username),
                )
            return
        client.drop_out_messages()  # or paho would send old retained values after the new ones
        client.subscribe(
            [
                (f"{self._base}/req/+", SubscribeOptions(1, noLocal=True, retainHandling=2)),
                *((f"{self._base}/{topic}", SubscribeOptions(1, noLocal=True)) for topic in self._watched),
            ]
        )
        with self._lock:
            self._connected = not self._stopping
            self._size_limit.connected(packet_bytes_max(properties), time.monotonic_ns())
            self._counters["connects"] += 1
            self._set_reason(None)
            state = self._outlets["state"]
        self._pump(state)
        if self._stopping:
            client.disconnect()

    def _on_connect_fail(self, _client: Client, _userdata: Any) -> None:
        error, text = connect_failure()
        with self._lock:
            if not self._stopping:
                fix = connect_fix(error, self._host, self._port, self._tls_ca)
                self._set_reason(self._with_address(ReasonCode.UNREACHABLE, text), fix)

    def _on_disconnect(self, _client: Client, _userdata: Any, _flags: Any, code: MqttCode, _properties: Any) -> None:
        if self._connected:
            self._drop(self._with_address(ReasonCode.LOST, f"connection lost ({code})"), code.value)
        elif not self._refused and not self._stopping:  # else the refusal stays the reason, or we ended it ourselves
            text = f"accepts connections but does not answer as an MQTT 5 broker ({code})"
            with self._lock:
                self._set_reason(self._with_address(ReasonCode.NO_ANSWER, text), no_answer_fix(self._tls_ca))

    def _drop(self, reason: Reason, code: int | None = None) -> None:
        with self._lock:
            failed = self._lose(reason, code)
        self._settle("failed", failed)

    def _on_subscribe(
        self, _client: Client, _userdata: Any, _mid: int, codes: list[MqttCode], _properties: Any
    ) -> None:
        with self._lock:
            for topic, code in zip(("req/+", *self._watched), codes, strict=False):
                self._note(topic, 0, code)

    def _on_message(self, topic: str, message: MQTTMessage) -> None:
        if (on_payload := self._watched.get(topic.removeprefix(f"{self._base}/"))) is not None:
            on_payload(bytes(message.payload))
            return
        request = read_request(self._base, topic, message)
        with self._lock:
            self._counters["bad_requests" if isinstance(request, BadRequest) else "requests"] += 1
        if isinstance(request, Request):
            self._on_request(request)
        elif request.topic is not None:
            self._send_once("replies", request.topic, request.answer, request.correlation)
