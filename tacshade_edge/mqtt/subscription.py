"""A subscription that paho's thread keeps alive, for a reader that waits in its own.

The client's wheel contains this file too (client/hatch_build.py).
"""

from __future__ import annotations

import logging
import os
import secrets
import threading
import time
from collections.abc import Callable, Collection
from typing import Final

from paho.mqtt.client import MQTTMessage, topic_matches_sub
from paho.mqtt.reasoncodes import ReasonCode as MqttCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from ..errors import ConfigError, DecodeError, DeviceError
from ..quoting import quoted
from ..reasons import ReasonCode
from ..wire.broker_address import host_and_port
from .client import (
    FRAMES_BYTES_MAX,
    BrokerAddress,
    BrokerSession,
    SessionEvents,
    broker_at,
    denial,
)

_log = logging.getLogger(__name__)

_FIRST_S: Final = 5.0
_LOG_PERIOD_S: Final = 10.0
_STATES: Final = "tacshade/+/state"
# Anyone who reaches the broker may publish a state, and the line is for a person.
_THERE_MAX: Final = 64


def address_of(
    broker: str, username: str | None, password: str | None, ca_file: str | os.PathLike[str] | None
) -> BrokerAddress:
    """Return the address that a program states as HOST or HOST:PORT. Raises ConfigError."""
    host, port = host_and_port(broker)
    if password is not None and username is None:
        raise ConfigError("password: found a password without a username, expected both")
    tls_ca = None if ca_file is None else os.fspath(ca_file)
    return broker_at(host, port, username=username, password=password, tls_ca=tls_ca)


class Subscription:
    """Subscribed to topics below ``tacshade/`` and a name from its construction until `close`.

    `take_in`: ``take_in(topic, message)``, called for each message; DecodeError from it refuses the
    message. `connected`: called before the messages of each connection. Both run in
    paho's thread and hold `changed`, which notifies the reader; whoever reads what they keep holds
    it too. A lost connection is restored every second, with a line in the log.

    `refused`: number of messages that no daemon publishes (the log shows the first, and one every
    10 s). Raises ConfigError, and DeviceError if the broker cannot be reached, does not answer, or
    rejects the connection or the topics.
    """

    def __init__(
        self,
        broker: BrokerAddress,
        name: str,
        topics: Collection[str],
        take_in: Callable[[str, MQTTMessage], None],
        connected: Callable[[], None] = lambda: None,
    ) -> None:
        self.where, self.base = f"{broker['host']}:{broker['port']}", f"tacshade/{name}"
        self.changed = threading.Condition()
        self.refused, self.closed = 0, False
        self._take_in, self._connected = take_in, connected
        self._topics: frozenset[str] = frozenset()
        # Whether the broker has ever granted the topics.
        self._subscribed = False
        self._failure: tuple[str, ReasonCode] | None = None
        self._awaited = True
        self._logged = ""
        self._crash: Exception | None = None
        self._next_line_s = 0.0
        # The states that were asked for, by name.
        self._there: dict[str, str] | None = None
        events = SessionEvents(
            accepted=self._on_accepted,
            subscribed=self._on_subscribed,
            rejected=lambda text, _code: self._fail(text, ReasonCode.REFUSED),
            unreachable=lambda _error, text: self._fail(text, ReasonCode.UNREACHABLE),
            lost=lambda code: self._fail(f"connection lost ({code})", ReasonCode.LOST),
            heard=self._on_message,
            # A defect in our own thread must not look like a silent sensor: `wait` raises it.
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
            with self.changed:
                self.wait(lambda: self._subscribed or self._failure, _FIRST_S)
                if not self._subscribed:
                    raise self.failure()
        except BaseException:
            self.close()
            raise

    def follow(self, topics: Collection[str]) -> None:
        """Replace the topics below the name; callable from any thread."""
        wanted = frozenset(f"{self.base}/{topic}" for topic in topics)
        with self.changed:
            self._topics = wanted
        # With QoS 1 a broker drops messages beyond its queue's size,
        # and so most of many retained ones.
        self._session.follow(dict.fromkeys(sorted(wanted), SubscribeOptions(0)))

    def close(self) -> None:
        """Disconnect, and end each `wait`; safe to call twice."""
        with self.changed:
            if self.closed:
                return
            self.closed = True
            self.changed.notify_all()
        self._session.stop()

    def refuse(self, error: DecodeError) -> None:
        """Count a message that no daemon publishes."""
        now_s = time.monotonic()
        with self.changed:
            self.refused += 1
        # Whoever reaches the broker could fill the disk with lines.
        if now_s >= self._next_line_s:
            self._next_line_s = now_s + _LOG_PERIOD_S
            _log.warning("%s: %s (%d messages rejected so far)", self.where, error, self.refused)

    # -- for a reader that holds `changed` ---------------------------------------------------------

    @property
    def failed(self) -> bool:
        """Whether the connection was lost, or an attempt failed during a `wait`."""
        return self._failure is not None

    def failure(self) -> DeviceError:
        """Report and forget it."""
        text, code = self._failure or ("the broker does not answer", ReasonCode.NO_ANSWER)
        self._failure = None
        expected = f"expected a broker that serves topics under {self.base}/"
        return DeviceError(f"{self.where}: {text}; {expected}", code=code)

    def wait(self, ready: Callable[[], object], timeout_s: float | None) -> bool:
        """Wait until `ready`; False at the end of the time, or when the subscription is closed.

        Raises DeviceError: the thread that receives has ended with the exception that is its cause.
        """
        self._awaited = True
        # More is an OverflowError.
        most_s = None if timeout_s is None else min(timeout_s, threading.TIMEOUT_MAX)
        try:
            self.changed.wait_for(lambda: ready() or self.closed or self._crash, most_s)
        finally:
            self._awaited = False
        if self._crash is not None and not self.closed:
            text = f"{self.where}: receiving ended: {self._crash!r}"
            raise DeviceError(text, code=ReasonCode.LOST) from self._crash
        return not self.closed and bool(ready())

    def ask_who_is_there(self) -> None:
        """Ask for all sensors' states: retained, they come within a second."""
        self._there = {}
        self._session.subscribe(_STATES, 0)

    def who_is_there(self) -> str:
        """List the sensors whose states have come since `ask_who_is_there`, for a person."""
        there, self._there = self._there or {}, None
        if _STATES not in self._topics:
            self._session.unsubscribe(_STATES)
        return (
            ", ".join(f"{name} ({state})" for name, state in sorted(there.items())) or "no sensor"
        )

    # -- called by the session, in paho's thread ---------------------------------------------------

    def _fail(self, text: str, code: ReasonCode) -> None:
        with self.changed:
            # While nobody waits, an attempt that failed is followed by others.
            if self._failure is None and (self._awaited or code is ReasonCode.LOST):
                self._failure = text, code
            if self._subscribed and not self.closed and text != self._logged:
                self._logged = text
                _log.warning("%s: %s; trying again", self.where, text)
            self.changed.notify_all()

    def _on_accepted(self, _bytes_max: object) -> None:
        with self.changed:
            self._connected()
            if not self._topics:  # then there is no answer to wait for
                self._subscribed = True
                self.changed.notify_all()

    def _on_subscribed(self, codes: list[MqttCode]) -> None:
        if denied := denial(codes):
            if self._there is None:  # else nobody is named
                self._fail(denied, ReasonCode.REFUSED)
            return
        with self.changed:
            if self._logged:
                _log.info("%s: connected again", self.where)
            self._subscribed, self._failure, self._logged = True, None, ""
            self.changed.notify_all()

    def _on_crash(self, error: Exception) -> None:
        with self.changed:
            self._crash = error
            self.changed.notify_all()

    def _on_message(self, topic: str, message: MQTTMessage) -> None:
        try:
            if "\ufffd" in topic or not topic.startswith("tacshade/"):
                found = f"found the topic {quoted(topic)}, expected one of a sensor or hand"
                raise DecodeError(found)
            with self.changed:
                if any(topic_matches_sub(wanted, topic) for wanted in self._topics):
                    self._take_in(topic, message)
                    self.changed.notify_all()
                # Else it is a state, or was unsubscribed.
                elif self._there is not None and len(self._there) < _THERE_MAX:
                    name, state = topic.split("/")[1], message.payload[:20].decode(errors="replace")
                    self._there[quoted(name)[1:-1]] = quoted(state)[1:-1]
        except DecodeError as error:
            self.refuse(error)
