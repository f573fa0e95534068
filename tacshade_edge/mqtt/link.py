"""The daemon's connection to the MQTT broker: its requests, its will, why it is not connected.

What it sends is `Outgoing`'s, the connection itself `BrokerSession`'s.
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
from typing import Final, Literal

from paho.mqtt.client import MQTTMessage
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
from tacshade_edge.mqtt.client import BrokerAddress, BrokerSession, SessionEvents
from tacshade_edge.mqtt.client_id_guard import ClientIdGuard, new_instance
from tacshade_edge.mqtt.outgoing import CONTENT_TYPES, Outgoing, PayloadOutcome
from tacshade_edge.mqtt.packets import PACKET_TOO_LARGE, publish_properties
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
    # Properties exist only with MQTT 5; requests of version 3.1.1 are answered on res/<verb>.
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
_OWN: Final = ("state", "info", "instance", "status/+")
"""What stays retained, and is published again if somebody deletes it."""


class MqttLink:
    """A connection that publishes streams, retained values and replies, and receives requests.

    `base_topic`: ``tacshade/<sensor-id>``, without a slash at either end. `client_id`: fixed per
    sensor: a new connection must take over from a dead one, including its will. It does not take
    over from a live one: while another daemon uses the sensor's name, this one waits. `on_request`
    is called from paho's network thread, `on_outcome` also from the callers' threads; they must
    only count or enqueue. Raises ConfigError (a host name, topic or authority file that can never
    work).
    """

    def __init__(
        self,
        broker: BrokerAddress,
        *,
        base_topic: str,
        client_id: str,
        on_request: Callable[[Request], None],
        on_outcome: Callable[[str, int, PayloadOutcome], None],
    ) -> None:
        self._broker, self._where = broker, f"{broker['host']}:{broker['port']}"
        self._base, self._on_request = base_topic, on_request
        events = SessionEvents(
            before_connect=self._before_connect,
            accepted=self._on_accepted,
            subscribed=lambda codes: self._outgoing.post(lambda: self._subscribed(codes)),
            rejected=self._on_rejected,
            unreachable=self._on_unreachable,
            lost=self._on_ended,
            unanswered=self._on_ended,
            heard=self._on_message,
            answered=lambda mid, code: self._outgoing.post(
                lambda: self._outgoing.answered(mid, code)
            ),
        )
        self._session = BrokerSession(broker, events, client_id=client_id, base_topic=base_topic)
        # Before the first connection, whose first packet contains it.
        will = publish_properties(CONTENT_TYPES["state"], of_will=True)
        self._session.will_set(
            f"{base_topic}/state", b"offline", qos=1, retain=True, properties=will
        )
        self._outgoing = Outgoing(self._session, self._where, base_topic, on_outcome)
        self._reason: Reason | None = self._with_address(ReasonCode.STARTING, "not started")
        self._watched: dict[str, Callable[[bytes], None]] = {}
        self._retained = set[str]()
        self._thread: threading.Thread | None = None
        self._settled = threading.Event()
        instance = new_instance()
        # A session of its own, since the link's would take the name by connecting.
        self._guard = ClientIdGuard(broker, base_topic, instance)
        self.set_retained("state", b"online")
        self.set_retained("instance", json.dumps(instance).encode())

    @property
    def connected(self) -> bool:
        """Whether the broker has accepted us."""
        return self._outgoing.connected

    @property
    def reason(self) -> Reason | None:
        """The reason why the link is not connected; None when it is."""
        return self._reason

    @property
    def limited(self) -> Reason | None:
        """Why the broker gets no large messages; None while no message
        of this connection has exceeded its limit.
        """
        return self._outgoing.limited

    def counters(self) -> dict[str, int]:
        """Return the counts since the start, always of all names: `Outgoing.counters`."""
        counts = self._outgoing.counters()
        return {**counts, "bad_requests": counts["bad_requests"] + self._session.refused}

    def start(self) -> None:
        """Start connecting, and keep trying until `stop`; an absent broker is no error.

        Call once.
        """
        self._set_reason(self._with_address(ReasonCode.STARTING, "connecting"))
        # A retained request is an old one, which must not be executed again on each connection.
        topics = {f"{self._base}/req/+": SubscribeOptions(1, noLocal=True, retainHandling=2)}
        for topic in self._watched:
            topics[f"{self._base}/{topic}"] = SubscribeOptions(1, noLocal=True)
        # What others publish there is a deletion, or a mistake.
        for topic in _OWN:
            topics[f"{self._base}/{topic}"] = SubscribeOptions(1, noLocal=True, retainHandling=2)
        self._session.follow(topics)
        self._session.start()

    def wait_until_settled(self, timeout_s: float) -> None:
        """Wait until the broker has answered our subscriptions, or it is known why it has not
        accepted us.
        """
        self._settled.wait(timeout_s)

    def stop(self, timeout_s: float) -> None:
        """Publish what waits and ``state`` = ``stopped``, and disconnect;
        always return within `timeout_s`.

        A broker that does not accept that in time publishes the last will, ``offline``, instead.
        Every payload not sent by then has failed.
        """
        began_s = time.monotonic()

        def left_s(part: float) -> float:
            return max(0.0, began_s + part * timeout_s - time.monotonic())

        # Each step leaves time for the next: a broker that stalls in one must not take all of it.
        self._outgoing.finish(b"stopped", left_s(0.6))
        self._session.disconnect()
        self._outgoing.wait_until_away(left_s(0.8))
        self._end_thread(left_s(1.0))
        done = threading.Event()
        self._outgoing.post(self._give_up)
        # After the other: whoever has the turn executes them in order.
        self._outgoing.post(done.set)
        done.wait(left_s(1.0))

    def set_retained(self, topic: str, payload: bytes, *, qos: Literal[0, 1] = 1) -> None:
        """Publish a retained value now and on every connection: `Outgoing.set_retained`."""
        self._retained.add(topic)
        self._outgoing.set_retained(topic, payload, qos=qos)

    def has_listener(self, stream: str) -> bool:
        """Whether a stream may have a subscriber: `Outgoing.has_listener`."""
        return self._outgoing.has_listener(stream)

    def offer(self, stream: str, payload: bytes, seq: int) -> None:
        """Send a payload of a stream unless a newer one comes first: `Outgoing.offer`."""
        self._outgoing.offer(stream, payload, seq)

    def reply(self, request: Request, payload: bytes) -> None:
        """Answer a request on ``res/<verb>`` or on its MQTT 5 response topic.

        Lost with the connection.
        """
        topic = request.response_topic or f"res/{request.verb}"
        self._outgoing.send_once("replies", topic, payload, request.correlation)

    def publish_event(self, topic: str, payload: bytes) -> None:
        """Publish an event once, under the base topic (QoS 1, not retained).

        Lost with the connection, and counted.
        """
        self._outgoing.send_once("events", topic, payload, None)

    def watch(self, topic: str, on_payload: Callable[[bytes], None]) -> None:
        """Subscribe to a topic below the base on every connection, retained value included;
        call before `start`.

        `on_payload` is called like `on_request`, but not for what this link itself publishes there.
        If it raises DecodeError, that is a bad request.
        """
        self._watched[topic] = on_payload

    # -- executed in turn --------------------------------------------------------------------------

    def _give_up(self) -> None:
        self._outgoing.give_up()
        self._set_reason(self._with_address(ReasonCode.STOPPED, "stopped"))

    def _disconnected(self, code: MqttCode | None) -> None:
        """Record that a connection ended; paho may lose one without a code."""
        if self.connected and not self._outgoing.stopping:
            why = "connection lost" if code is None else f"connection lost ({code})"
            fix = (
                MESSAGE_SIZE_FIX
                if code is not None and code.value == PACKET_TOO_LARGE
                else BROKERS_LOG
            )
            self._set_reason(self._with_address(ReasonCode.LOST, why), fix)
        elif (
            code is not None
            and not self._outgoing.stopping
            and not (self._reason and self._reason.code is ReasonCode.REFUSED)
        ):
            text = f"accepts connections but does not answer as an MQTT 5 broker ({code})"
            self._set_reason(
                self._with_address(ReasonCode.NO_ANSWER, text),
                no_answer_fix(self._broker["tls_ca"]),
            )
        self._outgoing.lost()

    def _subscribed(self, codes: list[MqttCode]) -> None:
        for topic, code in zip(("req/+", *self._watched), codes, strict=False):
            self._outgoing.note(topic, 0, code)
        # Not as soon as it accepts us: until then, it drops the requests of other connections.
        self._settled.set()

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
        if reason is not None and reason.code is not ReasonCode.STARTING:
            self._settled.set()
        if reason and fix:
            _log.warning("%s", with_fix(reason, fix))
        else:
            _log.info("%s", reason or f"{self._where}: connected")

    def _end_thread(self, timeout_s: float) -> None:
        """Wait for paho's thread; leave one that hangs in a connection attempt,
        since it is a daemon thread.
        """
        # Ends the thread's wait for a peer that neither reads nor closes.
        sock = self._session.socket()
        if sock is not None:
            with contextlib.suppress(OSError):  # it was already closed
                sock.shutdown(socket.SHUT_RDWR)  # type: ignore[attr-defined]
        if self._thread is not None:
            self._thread.join(timeout_s)
            if not self._thread.is_alive():
                self._session.release()

    # -- called by the session, in paho's thread ---------------------------------------------------

    def _before_connect(self) -> None:
        self._thread = threading.current_thread()
        # paho may lose a connection without a word; what it held then has failed.
        self._outgoing.post(lambda: self._disconnected(None))
        self._guard.wait_until_gone(self._report_holder, lambda: self._outgoing.stopping)
        if self._outgoing.stopping:
            # To paho an OSError is a failed attempt; any other exception would end its thread, and
            # with it the daemon.
            raise ConnectionAbortedError("stopped")

    def _report_holder(self, reason: Reason) -> None:
        self._set_reason(reason, "stop the other daemon, or wait until it ends")

    def _on_accepted(self, bytes_max: int | None) -> None:
        if self._outgoing.stopping:
            # `stop` came while we connected, when there was no connection that it could end.
            self._session.disconnect()
            return
        # Or paho would send old retained values after the new ones.
        self._session.drop_out_messages()
        # In turn, after whatever the last connection still has to settle.
        self._outgoing.post(lambda: self._set_reason(None))
        self._outgoing.post(lambda: self._outgoing.accepted(bytes_max))

    def _on_rejected(self, text: str, code: MqttCode) -> None:
        fix = refusal_fix(code.value, self._broker["username"])
        self._set_reason(self._with_address(ReasonCode.REFUSED, text), fix)

    def _on_unreachable(self, error: BaseException | None, text: str) -> None:
        if not self._outgoing.stopping:
            host, port, tls_ca = self._broker["host"], self._broker["port"], self._broker["tls_ca"]
            reason = self._with_address(ReasonCode.UNREACHABLE, text)
            self._set_reason(reason, connect_fix(error, host, port, tls_ca))

    def _on_ended(self, code: MqttCode) -> None:
        self._outgoing.post(lambda: self._disconnected(code))

    def _on_message(self, topic: str, message: MQTTMessage) -> None:
        if (on_payload := self._watched.get(topic.removeprefix(f"{self._base}/"))) is not None:
            on_payload(bytes(message.payload))
            return
        own = topic.removeprefix(f"{self._base}/")
        if own in _OWN or own.startswith("status/"):
            # Somebody has deleted it, with which pages and Home Assistant would lose the sensor.
            if own in self._retained and not message.payload and not self._outgoing.stopping:
                self._outgoing.set_retained(own, None)
            return
        request = read_request(self._base, topic, message)
        kind = "bad_requests" if isinstance(request, BadRequest) else "requests"
        self._outgoing.post(lambda: self._outgoing.count(kind))
        if isinstance(request, Request):
            self._on_request(request)
        elif request.topic is not None:
            self._outgoing.send_once("replies", request.topic, request.answer, request.correlation)
