"""Messages of sensors and hands, decoded one by one.

The client's wheel contains this file too (client/hatch_build.py).
"""

from __future__ import annotations

import itertools
import logging
import os
import time
from collections.abc import Collection, Iterator
from types import TracebackType
from typing import Final, Self

from paho.mqtt.client import MQTTMessage

from ..errors import ConfigError, DecodeError
from ..quoting import quoted
from ..wire.received import Message, decode_message
from ..wire.topics import OF_HANDS, OF_SENSORS
from .client import BrokerAddress
from .subscription import Subscription, address_of

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
SILENT_S = 5.0
"""Silence from the start after which the sensors that are there are asked for:
a name may be misspelt.
"""
_STATES_S: Final = 1.0
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
    if not name.removeprefix("hand/") or set(name.removeprefix("hand/")) & set("/#\0"):
        raise ConfigError(f"name: found {quoted(name)}, expected {_NAME}")
    return Listener(address_of(broker, username, password, ca_file), name, topics)


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
        self.passed_over = self.dropped = 0
        self._waiting: dict[str | int, tuple[str, bytes, bool]] = {}
        self._numbers = itertools.count()
        self._topics = _checked(topics)
        # Of a silence from the start: when to ask who is there, then when to log it.
        self._ask_s: float | None = time.monotonic() + SILENT_S
        self._asked = False
        self._subscription = Subscription(broker, name, self._topics, self._take_in)

    @property
    def refused(self) -> int:
        """Number of messages that no daemon publishes."""
        return self._subscription.refused

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
            with self._subscription.changed:
                if not self._wait(end_s):
                    return None
                topic, payload, retained = self._waiting.pop(next(iter(self._waiting)))
            try:
                return decode_message(topic, payload, retained=retained)
            except DecodeError as error:
                self._subscription.refuse(error)

    def _wait(self, end_s: float | None) -> bool:
        """Wait for a message or the end; whether there is a message. Lock held."""
        while True:
            now_s = time.monotonic()
            if self._ask_s is not None and now_s >= self._ask_s:
                self._name_those_there(now_s)
            ends_s = [at_s for at_s in (end_s, self._ask_s) if at_s is not None]
            left_s = min(ends_s) - now_s if ends_s else None
            if self._subscription.wait(lambda: self._waiting, left_s):
                return True
            if self._subscription.closed or (end_s is not None and time.monotonic() >= end_s):
                return False

    def _name_those_there(self, now_s: float) -> None:
        """After a silence from the start, ask for the sensors' states; a second later, log them.

        Lock held.
        """
        if not self._asked:
            self._asked, self._ask_s = True, now_s + _STATES_S
            self._subscription.ask_who_is_there()
            return
        self._ask_s = None
        where, base = self._subscription.where, self._subscription.base
        topics = ", ".join(f"{base}/{topic}" for topic in sorted(self._topics))
        there = self._subscription.who_is_there()
        _log.warning("%s: no message on %s so far; there are %s", where, topics, there)

    def follow(self, topics: Collection[str]) -> None:
        """Replace the subscribed topics with these; callable from any thread.

        Raises ConfigError.
        """
        self._topics = _checked(topics)
        self._subscription.follow(self._topics)

    def close(self) -> None:
        """Disconnect; safe to call twice. A waiting `get` returns None."""
        self._subscription.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _take_in(self, topic: str, message: MQTTMessage) -> None:
        """Let a message wait. Called in paho's thread, lock held."""
        if self._ask_s is not None:
            self._ask_s = None
            if self._asked:
                self._subscription.who_is_there()  # for nobody: the name is right
        part = topic.split("/", 3 if topic.startswith("tacshade/hand/") else 2)[-1]
        key: str | int = topic if part in NEWEST_WINS else next(self._numbers)
        if key in self._waiting:
            self.passed_over += 1
        elif len(self._waiting) >= WAITING_MAX:
            del self._waiting[next(iter(self._waiting))]
            self.dropped += 1
        self._waiting[key] = topic, bytes(message.payload), bool(message.retain)


def _checked(topics: Collection[str]) -> frozenset[str]:
    if isinstance(topics, str) or not all(
        topic.strip("/") == topic != "" and "\0" not in topic for topic in topics
    ):
        raise ConfigError(
            f"topics: found {topics!r}, expected several such as ['height', 'contact', 'status/+']"
        )
    return frozenset(topics)
