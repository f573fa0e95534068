"""The payloads of one topic that wait or that paho holds: the latest wins, so memory is bounded.

A stream also knows whether it has subscribers: an MQTT 5 broker reports if no subscription matches a QoS 1 message.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from paho.mqtt.properties import Properties

PayloadOutcome = Literal["published", "superseded", "failed", "refused"]

PROBE_PERIOD_NS = 1_000_000_000
"""Period in ns at which a message of a stream probes for subscribers, so a new one is noticed within it. Whole periods
of the clock, so that the streams of a frame probe together: a frame that only probes is reconstructed for nobody."""


@dataclass(frozen=True, slots=True, eq=False)
class Item:
    """One payload that is being published."""

    payload: bytes
    seq: int


@dataclass(slots=True, eq=False)
class TopicSlot:
    """The latest-wins slot of one topic. It has no lock: its owner guards it.

    `retain`: the newest retained value is sent again on every connection, and has no outcome. `most`: how many payloads
    paho may hold unsent (QoS 0) or unacknowledged (QoS 1). `waiting`: the payload in the slot. `handed`: the items that
    paho holds, oldest first. `busy`: true while a thread is between `take` and the end of its publish; no other may
    `take`, which keeps the order. `probed_ns`: time of the latest probe for subscribers, CLOCK_MONOTONIC; None before
    the first. `no_listener`: the broker's latest answer reported no subscribers. `refused`: the broker's latest answer
    rejected the message; None before the first answer of a connection.
    """

    topic: str
    qos: int
    retain: bool
    most: int
    properties: Properties
    waiting: Item | None = None
    handed: list[Item] = field(default_factory=list)
    busy: bool = False
    probed_ns: int | None = None
    no_listener: bool = False
    refused: bool | None = None
    _newest: Item | None = None

    @property
    def idle(self) -> bool:
        """Whether no item waits and paho holds none."""
        return self.waiting is None and not self.handed

    def probe_due(self, now_ns: int) -> bool:
        """Whether the next message should probe for subscribers."""
        return self.probed_ns is None or now_ns // PROBE_PERIOD_NS != self.probed_ns // PROBE_PERIOD_NS

    def next_qos(self, now_ns: int) -> int:
        """Return the QoS of the message being sent: 1 for a probe. Until its answer comes, the previous one holds."""
        if self.retain or not self.probe_due(now_ns):
            return self.qos
        self.probed_ns = now_ns
        return 1

    def put(self, item: Item) -> Item | None:
        """Fill the slot; return the displaced item, or None."""
        displaced, self.waiting, self._newest = self.waiting, item, item
        return displaced

    def take(self) -> Item | None:
        """Claim the waiting item for publishing; return None if there is none or it is not yet its turn."""
        if self.busy or self.waiting is None or len(self.handed) >= self.most:
            return None
        item, self.waiting, self.busy = self.waiting, None, True
        self.handed.append(item)
        return item

    def done(self, item: Item) -> None:
        """Remove an item that paho has sent (QoS 0) or delivered (QoS 1)."""
        self.handed.remove(item)

    def refuse(self, item: Item) -> Item | None:
        """Take back an item that paho rejected: it waits again, or is returned as failed if a newer one waits."""
        self.handed.remove(item)
        if self.waiting is None:
            self.waiting = item
            return None
        return None if self.retain else item

    def give_back(self) -> list[Item]:
        """Take back the items paho held: the newest waits again unless a newer one does; return the failed others."""
        lost, self.handed = self.handed, []
        self.probed_ns, self.no_listener, self.refused = None, False, None
        if self.retain:
            self.waiting = self._newest
            return []
        if self.waiting is None and lost:
            self.waiting = lost.pop()
        return lost

    def drain(self) -> list[Item]:
        """Empty the slot; return all its items, oldest first."""
        left = [*self.handed, *([] if self.waiting is None else [self.waiting])]
        self.handed, self.waiting = [], None
        return left
