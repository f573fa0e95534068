"""The connection to the MQTT broker, which reconnects by itself;
`Outgoing` handles what it sends.
"""

from __future__ import annotations

import contextlib
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

from tacshade_edge.errors import DecodeError
from tacshade_edge.fixes import (
    BROKERS_LOG,
    MESSAGE_SIZE_FIX,
    connect_fix,
    no_answer_fix,
    refusal_fix,
    with_fix,
)
from tacshade_edge.mqtt.client import (
    PACKET_TOO_LARGE,
    BrokerAddress,
    connect,
    connect_failure,
    make_client,
    packet_bytes_max,
    publish_properties,
)
from tacshade_edge.mqtt.client_id_guard import ClientIdGuard, new_instance
from tacshade_edge.mqtt.outgoing import CONTENT_TYPES, Outgoing, PayloadOutcome
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.wire.requests import Request, encode_error, parse_request, parse_transaction


@dataclass(frozen=True, slots=True)
class BadRequest:
    """A rejected request.

    `topic`: topic for `answer`, below the base topic; None if it cannot be answered.
    """

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
        return BadRequest(
            answer_on, encode_error(parse_transaction(payload), error.reason), correlation
        )


def _may_name_a_topic(text: str) -> bool:
    """Whether this may be published on: a broker ends the connection for a control character,
    paho raises for others.

    U+FFFD is what was not UTF-8, and longer.
    """
    return text.isprintable() and not set(text) & set("+#\ufffd")


_log = logging.getLogger(__name__)


class MqttLink(Outgoing):
    """A connection that publishes streams, retained values and replies, and receives requests.

    `base_topic`: ``tacshade/<sensor-id>``, without a slash at either end. `client_id`: fixed per
    sensor: a new connection must take over from a dead one, including its will. It does not take
    over from a live one: while another daemon uses the sensor's name, this one waits. `tls_ca`: PEM
    file of the authority that signed the broker's certificate; None disables TLS. `on_request` is
    called from paho's network thread, `on_outcome` also from the callers' threads; they must only
    count or enqueue. Raises ConfigError (a host name, topic or authority file that can never work).
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
        self._broker = BrokerAddress(
            host=host, port=port, username=username, password=password, tls_ca=tls_ca
        )
        client, asking = (
            make_client(self._broker, base_topic=base_topic, client_id=name)
            for name in (client_id, "")
        )
        super().__init__(client, f"{host}:{port}", base_topic, on_outcome)
        self._on_request = on_request
        self._reason: Reason | None = self._with_address(ReasonCode.STARTING, "not started")
        self._watched: dict[str, Callable[[bytes], None]] = {}
        self._thread: threading.Thread | None = None
        self._guard = ClientIdGuard(asking, host, port, base_topic, instance)
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
        """Start connecting, and keep trying until `stop`; an absent broker is no error.

        Call once.
        """
        self._set_reason(self._with_address(ReasonCode.STARTING, "connecting"))
        connect(self._client, self._broker["host"], self._broker["port"])

    def stop(self, timeout_s: float) -> None:
        """Publish what waits and ``state`` = ``stopped``, and disconnect;
        always return within `timeout_s`.

        A broker that does not accept that in time publishes the last will, ``offline``, instead.
        Every payload not sent by then has failed.
        """
        began_s = time.monotonic()

        def left_s(part: float) -> float:
            return max(0.0, began_s + part * timeout_s - time.monotonic())

        self._state_sent.clear()
        self._post(self._pump_last)
        self.set_retained("state", b"stopped")
        if self.connected:
            self._state_sent.wait(left_s(0.6))
        self._stopping = True
        self._client.disconnect()
        self._away.wait(left_s(0.8))
        self._end_thread(left_s(1.0))
        done = threading.Event()
        self._post(self._give_up)
        self._post(done.set)
        done.wait(left_s(1.0))

    def watch(self, topic: str, on_payload: Callable[[bytes], None]) -> None:
        """Subscribe to a topic below the base on every connection, retained value included;
        call before `start`.

        `on_payload` is called like `on_request`, but not for what this link itself publishes there.
        If it raises DecodeError, that is a bad request.
        """
        self._watched[topic] = on_payload

    # -- executed in turn --------------------------------------------------------------------------

    def _pump_last(self) -> None:
        """Send the last payload of each stream, however many paho holds."""
        for slot in self._slots.values():
            if not slot.retain:
                slot.most += 1
                self._pump(slot)

    def _give_up(self) -> None:
        self._lost()
        for slot in self._slots.values():
            if not slot.retain and slot.waiting is not None:
                self._settle("failed", slot, slot.waiting)
                slot.waiting = None
        self._set_reason(self._with_address(ReasonCode.STOPPED, "stopped"))

    def _disconnected(self, code: MqttCode | None) -> None:
        """Record that a connection ended; paho may lose one without a code."""
        if self.connected and not self._stopping:
            why = "connection lost" if code is None else f"connection lost ({code})"
            fix = (
                MESSAGE_SIZE_FIX
                if code is not None and code.value == PACKET_TOO_LARGE
                else BROKERS_LOG
            )
            self._set_reason(self._with_address(ReasonCode.LOST, why), fix)
        elif (
            code is not None
            and not self._stopping
            and not (self._reason and self._reason.code is ReasonCode.REFUSED)
        ):
            text = f"accepts connections but does not answer as an MQTT 5 broker ({code})"
            self._set_reason(
                self._with_address(ReasonCode.NO_ANSWER, text),
                no_answer_fix(self._broker["tls_ca"]),
            )
        self._lost()

    def _subscribed(self, codes: list[MqttCode]) -> None:
        for topic, code in zip(("req/+", *self._watched), codes, strict=False):
            self._note(topic, 0, code)

    # ----------------------------------------------------------------------------------------------

    def _with_address(self, code: ReasonCode, text: str) -> Reason:
        return Reason(code, f"{self._where}: {text}")

    def _set_reason(self, reason: Reason | None, fix: str = "") -> None:
        """Store why we are not connected; log a change, not a repetition.

        A reason with a fix is a fault.
        """
        if reason == self._reason:
            return
        self._reason = reason
        if reason and fix:
            _log.warning("%s", with_fix(reason, fix))
        else:
            _log.info("%s", reason or f"{self._where}: connected")

    def _end_thread(self, timeout_s: float) -> None:
        """Wait for paho's thread; leave one that hangs in a connection attempt,
        since it is a daemon thread.
        """
        sock = self._client.socket()
        if sock is not None:
            with contextlib.suppress(OSError):  # it was already closed
                sock.shutdown(socket.SHUT_RDWR)  # type: ignore[attr-defined]
        if self._thread is not None:
            self._thread.join(timeout_s)

    # -- called by paho, in its thread -------------------------------------------------------------

    def _on_pre_connect(self, _client: Client, _userdata: Any) -> None:
        self._thread = threading.current_thread()
        self._post(lambda: self._disconnected(None))
        self._guard.wait_until_gone(self._report_holder, lambda: self._stopping)
        if self._stopping:
            raise ConnectionAbortedError("stopped")

    def _report_holder(self, reason: Reason) -> None:
        self._set_reason(reason, "stop the other daemon, or wait until it ends")

    def _on_connect(
        self,
        client: Client,
        _userdata: Any,
        _flags: Any,
        code: MqttCode,
        properties: Properties | None,
    ) -> None:
        if code.is_failure:
            fix = refusal_fix(code.value, self._broker["username"])
            self._set_reason(
                self._with_address(ReasonCode.REFUSED, f"rejects the connection: {code}"), fix
            )
            return
        if self._stopping:
            client.disconnect()
            return
        client.drop_out_messages()  # or paho would send old retained values after the new ones
        wanted = {
            f"{self._base}/{topic}": SubscribeOptions(1, noLocal=True) for topic in self._watched
        }
        wanted[f"{self._base}/req/+"] = SubscribeOptions(1, noLocal=True, retainHandling=2)
        client.subscribe(list(wanted.items()))
        self._post(lambda: self._set_reason(None))
        self._post(lambda: self._accepted(packet_bytes_max(properties)))

    def _on_connect_fail(self, _client: Client, _userdata: Any) -> None:
        error, text = connect_failure()
        if not self._stopping:
            fix = connect_fix(
                error, self._broker["host"], self._broker["port"], self._broker["tls_ca"]
            )
            self._set_reason(self._with_address(ReasonCode.UNREACHABLE, text), fix)

    def _on_disconnect(
        self, _client: Client, _userdata: Any, _flags: Any, code: MqttCode, _properties: Any
    ) -> None:
        self._post(lambda: self._disconnected(code))

    def _on_subscribe(
        self, _client: Client, _userdata: Any, _mid: int, codes: list[MqttCode], _p: Any
    ) -> None:
        self._post(lambda: self._subscribed(codes))

    def _on_message(self, topic: str, message: MQTTMessage) -> None:
        if (on_payload := self._watched.get(topic.removeprefix(f"{self._base}/"))) is not None:
            on_payload(bytes(message.payload))
            return
        request = read_request(self._base, topic, message)
        kind = "bad_requests" if isinstance(request, BadRequest) else "requests"
        self._post(lambda: self._counters.update((kind,)))
        if isinstance(request, Request):
            self._on_request(request)
        elif request.topic is not None:
            self._send_once("replies", request.topic, request.answer, request.correlation)
