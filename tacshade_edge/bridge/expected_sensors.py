"""Sensors that a bridge was asked for, but that the broker does not know."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Collection
from typing import Final

from tacshade_edge.mqtt.client import BrokerAddress
from tacshade_edge.mqtt.follower import Follower
from tacshade_edge.quoting import shown

_log = logging.getLogger(__name__)

_STATES: Final = "tacshade/+/state"
# Retained states come together, right after the connection.
_TOGETHER_S: Final = 1.0
# Anyone who reaches the broker may publish a state, and the line is for a person.
_THERE_MAX: Final = 64


class ExpectedSensors:
    """Logs once, after the first states of any sensors came, which expected ones are not there."""

    def __init__(self, broker: BrokerAddress, expected: Collection[str]) -> None:
        self._where = f"{broker['host']}:{broker['port']}"
        self._expected = frozenset(expected)
        self._lock = threading.Lock()
        self._there: set[str] = set()
        self._due_s: float | None = None
        self._follower: Follower | None = None
        if self._expected:
            self._follower = Follower(
                broker, lambda topic, payload, _: self._hear(topic, payload), name="bridge-names"
            )
            self._follower.follow([_STATES])
            self._follower.start()

    def poll(self) -> None:
        """Log what is missing once it is known; call repeatedly."""
        with self._lock:
            if self._follower is None or self._due_s is None or time.monotonic() < self._due_s:
                return
            there = set(self._there)
        self.stop()
        if missing := self._expected - there:
            names = ", ".join(shown(name) for name in sorted(missing))
            known = ", ".join(shown(name) for name in sorted(there))
            _log.warning("%s: no sensor %s so far; there are %s", self._where, names, known)

    def stop(self) -> None:
        """Disconnect; safe to call twice."""
        if self._follower is not None:
            self._follower.stop()
            self._follower = None

    def _hear(self, topic: str, payload: bytes) -> None:
        with self._lock:
            # An empty state is that of a sensor that was removed.
            if payload and len(self._there) < _THERE_MAX:
                self._there.add(topic.split("/")[1])
                self._due_s = self._due_s or time.monotonic() + _TOGETHER_S
