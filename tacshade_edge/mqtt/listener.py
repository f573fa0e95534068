"""Receives messages of sensors and hands from a broker, and reconnects when it comes back."""

from __future__ import annotations

import itertools
import logging
import os
import secrets
import threading
import time
from collections.abc import Collection, Iterator
from types import TracebackType
from typing import Final, Self

from paho.mqtt.client import MQTTMessage, topic_matches_sub
from paho.mqtt.reasoncodes import ReasonCode as MqttCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from ..errors import ConfigError, DecodeError, DeviceError
from ..quoting import quoted
from ..reasons import ReasonCode
from ..wire.broker_address import host_and_port
from ..wire.received import Message, decode_message
from ..wire.topics import OF_HANDS, OF_SENSORS
from .client import (
    FRAMES_BYTES_MAX,
    BrokerAddress,
    BrokerSession,
    SessionEvents,
    broker_at,
    denial,
)

_log = logging.getLogger(__name__)

NEWEST_WINS: Final = frozenset(
    name for name, topic in {**OF_SENSORS, **OF_HANDS}.items() if topic.newest_wins
)
"""For each of these topics only the newest message waits;
for all others every message waits, in order.
"""
# Memory stays bounded if the reader stops reading.
WAITING_MAX: Final = 256
"""Most waiting messages; the next one replaces the oldest."""
_FIRST_S: Final = 5.0
_LOG_PERIOD_S: Final = 10.0
SILENT_S = 5.0
"""Silence from the start after which the sensors that are there are asked for:
a name may be misspelt.
"""
_STATES: Final = "tacshade/+/state"
_STATES_S: Final = 1.0
# Anyone who reaches the broker may publish a state, and the line is for a person.
_THERE_MAX: Final = 64
_NAME: Final = "a sensor such as left-index, hand/left of a hand, or + for all sensors"


def listen(
    broker: str,
    name: str,
    topics: Collection[str] = ("height",),
    *,
    username: str | None = None,
    password: str | None = None,
    ca_file: str | os.PathLike[str] | None = None,
) -> Listener:
    """Receive the messages of any number of sensors or hands (docs/reference/mqtt.md).

    On a topic with frames, contacts, touches or health only the newest message waits, so a slow
    reader skips some (`Listener.passed_over`). All others (``state``, ``status/...``,
    ``event/slip``, ``info``) wait in order; beyond 256 waiting messages the oldest is dropped
    (`Listener.dropped`). The listener reconnects automatically, with a line in the log
    (``logging``), and misses the messages published meanwhile.

    Parameters
    ----------
    broker : str
        ``HOST`` or ``HOST:PORT``; the default port is 1883.
    name : str
        A sensor's id, ``hand/`` and a hand's id, or ``+`` or ``hand/+`` for all.
    topics : collection of str
        Topics below the name: ``height``, ``contact``, ``status/+``.
        Sensors do not compute topics without subscribers.
    username, password : str, optional
        For a broker that requires a login.
    ca_file : path, optional
        Certificate of the authority that signed the broker's certificate; turns TLS on.

    Raises
    ------
    ConfigError
        The arguments can never work.
    DeviceError
        The broker cannot be reached, does not answer, or rejects the connection or a subscription.
    """
    host, port = host_and_port(broker)
    if not name.removeprefix("hand/") or set(name.removeprefix("hand/")) & set("/#\0"):
        raise ConfigError(f"name: found {quoted(name)}, expected {_NAME}")
    if password is not None and username is None:
        raise ConfigError("password: found a password without a username, expected both")
    tls_ca = None if ca_file is None else os.fspath(ca_file)
    broker_address = broker_at(host, port, username=username, password=password, tls_ca=tls_ca)
    return Listener(broker_address, name, topics)


class Listener(Iterator[Message]):
    """An iterator over received messages; `listen` makes it, ``with`` or `close` closes it.

    Iteration waits for the next message without a limit; `get` can wait for a limited time. paho's
    thread receives messages, and the caller's thread decodes them.

    Attributes
    ----------
    passed_over : int
        Number of messages replaced by a newer one on their topic before they were read.
    dropped : int
        Number of messages dropped because too many were waiting.
    refused : int
        Number of messages that no daemon publishes (the log shows the first, and one every 10 s).
    """

    def __init__(self, broker: BrokerAddress, name: str, topics: Collection[str]) -> None:
        self.passed_over = self.dropped = self.refused = 0
        self._where, self._base = f"{broker['host']}:{broker['port']}", f"tacshade/{name}"
        self._came = threading.Condition()
        self._waiting: dict[str | int, tuple[str, bytes, bool]] = {}
        self._numbers = itertools.count()
        self._topics = self._full(topics)
        self._subscribed = self._closed = False
        self._failure: tuple[str, ReasonCode] | None = None
        self._crash: Exception | None = None
        self._next_line_s = 0.0
        self._ask_s: float | None = time.monotonic() + SILENT_S
        # The state of each sensor, asked for after a long silence.
        self._there: dict[str, str] | None = None
        events = SessionEvents(
            accepted=self._on_accepted,
            subscribed=self._on_subscribed,
            rejected=lambda text, _code: self._fail(text, ReasonCode.REFUSED),
            unreachable=lambda _error, text: self._fail(text, ReasonCode.UNREACHABLE),
            lost=lambda code: self._fail(f"connection lost ({code})", ReasonCode.LOST),
            heard=self._on_message,
            # A defect in our own thread must not look like a silent sensor: `get` raises it.
            crashed=self._on_crash,
        )
        self._session = BrokerSession(
            broker,
            events,
            client_id=f"tacshade-client-{secrets.token_hex(6)}",
            incoming_bytes_max=FRAMES_BYTES_MAX,
        )
        self.follow(topics)
        # Last: from here on paho's thread calls us.
        self._session.start()
        try:
            self._wait_for_subscription()
        except BaseException:
            self.close()
            raise

    def __next__(self) -> Message:
        if (message := self.get()) is None:
            raise StopIteration
        return message

    def get(self, timeout_s: float | None = None) -> Message | None:
        """The next message; None if none arrives in time or the listener is closed.

        Parameters
        ----------
        timeout_s : float, optional
            Longest wait; unlimited by default.

        Raises
        ------
        DeviceError
            The thread that receives messages has ended with the exception that is this one's cause.
        """
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            with self._came:
                self._wait(end_s)
                if self._crash is not None and not self._closed:
                    text = f"{self._where}: receiving ended: {self._crash!r}"
                    raise DeviceError(text, code=ReasonCode.LOST) from self._crash
                if self._closed or not self._waiting:
                    return None
                topic, payload, retained = self._waiting.pop(next(iter(self._waiting)))
            try:
                return decode_message(topic, payload, retained=retained)
            except DecodeError as error:
                self._refuse(error)

    def _wait(self, end_s: float | None) -> None:
        """Wait for a message or the end. Lock held."""
        while not (self._waiting or self._closed or self._crash):
            now_s = time.monotonic()
            if end_s is not None and now_s >= end_s:
                return
            if self._ask_s is not None and now_s >= self._ask_s:
                self._name_those_there(now_s)
            ends_s = [at_s for at_s in (end_s, self._ask_s) if at_s is not None]
            self._came.wait(min(ends_s) - now_s if ends_s else None)

    def _name_those_there(self, now_s: float) -> None:
        """After a silence from the start, ask for the sensors' states; a second later, log them.

        Lock held.
        """
        if self._there is None:
            self._there, self._ask_s = {}, now_s + _STATES_S
            self._session.subscribe(_STATES, 0)
            return
        self._ask_s = None
        there = (
            ", ".join(f"{name} ({state})" for name, state in sorted(self._there.items()))
            or "no sensors"
        )
        topics = ", ".join(sorted(self._topics))
        _log.warning("%s: no message on %s so far; there are %s", self._where, topics, there)
        self._there = None
        if _STATES not in self._topics:
            self._session.unsubscribe(_STATES)

    def follow(self, topics: Collection[str]) -> None:
        """Replace the subscribed topics with these; callable from any thread.

        Raises ConfigError.
        """
        wanted = self._full(topics)
        with self._came:
            self._topics = wanted
        # With QoS 1 a broker drops messages beyond its queue's size,
        # and so most of many retained ones.
        self._session.follow(dict.fromkeys(sorted(wanted), SubscribeOptions(0)))

    def close(self) -> None:
        """Disconnect; safe to call twice. A waiting `get` returns None."""
        with self._came:
            if self._closed:
                return
            self._closed = True
            self._came.notify_all()
        self._session.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _full(self, topics: Collection[str]) -> frozenset[str]:
        if isinstance(topics, str) or not all(
            topic.strip("/") == topic != "" and "\0" not in topic for topic in topics
        ):
            raise ConfigError(
                f"topics: found {topics!r}, expected several such as ['height', 'contact', "
                "'status/+']"
            )
        return frozenset(f"{self._base}/{topic}" for topic in topics)

    def _wait_for_subscription(self) -> None:
        with self._came:
            self._came.wait_for(lambda: self._subscribed or self._failure, _FIRST_S)
            if not self._subscribed:
                text, code = self._failure or ("no answer", ReasonCode.NO_ANSWER)
                raise DeviceError(
                    (
                        f"{self._where}: {text}; expected a broker that serves topics under "
                        f"{self._base}/"
                    ),
                    code=code,
                )

    def _refuse(self, error: DecodeError) -> None:
        now_s = time.monotonic()
        with self._came:
            self.refused += 1
        # Whoever reaches the broker could fill the disk with lines.
        if now_s >= self._next_line_s:
            self._next_line_s = now_s + _LOG_PERIOD_S
            _log.warning("%s: %s (%d messages rejected so far)", self._where, error, self.refused)

    def _fail(self, text: str, code: ReasonCode) -> None:
        """Record a failure: `listen` raises that of the first connection;
        later ones are logged when they change.
        """
        with self._came:
            if self._failure != (text, code):
                self._failure = text, code
                if self._subscribed and not self._closed:
                    _log.warning("%s: %s; trying again", self._where, text)
            self._came.notify_all()

    # -- called by the session, in paho's thread ---------------------------------------------------

    def _on_accepted(self, _bytes_max: object) -> None:
        with self._came:
            if not self._topics:  # then there is no answer to wait for
                self._subscribed = True
                self._came.notify_all()

    def _on_subscribed(self, codes: list[MqttCode]) -> None:
        if denied := denial(codes):
            self._fail(denied, ReasonCode.REFUSED)
            return
        with self._came:
            if self._subscribed and self._failure is not None:
                _log.info("%s: connected again", self._where)
            self._subscribed, self._failure = True, None
            self._came.notify_all()

    def _on_crash(self, error: Exception) -> None:
        with self._came:
            self._crash = error
            self._came.notify_all()

    def _on_message(self, topic: str, message: MQTTMessage) -> None:
        if "\ufffd" in topic or not topic.startswith("tacshade/"):
            self._refuse(
                DecodeError(f"found the topic {quoted(topic)}, expected one of a sensor or hand")
            )
            return
        if not any(
            topic_matches_sub(wanted, topic) for wanted in self._topics
        ):  # unsubscribed, or for `_wait`
            with self._came:
                if self._there is not None and len(self._there) < _THERE_MAX:
                    name, state = topic.split("/")[1], message.payload[:20].decode(errors="replace")
                    self._there[quoted(name)[1:-1]] = quoted(state)[1:-1]
            return
        self._ask_s = None
        part = topic.split("/", 3 if topic.startswith("tacshade/hand/") else 2)[-1]
        with self._came:
            key: str | int = topic if part in NEWEST_WINS else next(self._numbers)
            if key in self._waiting:
                self.passed_over += 1
            elif len(self._waiting) >= WAITING_MAX:
                del self._waiting[next(iter(self._waiting))]
                self.dropped += 1
            self._waiting[key] = topic, bytes(message.payload), bool(message.retain)
            self._came.notify()
