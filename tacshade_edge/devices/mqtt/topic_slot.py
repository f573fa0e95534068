"""What of one topic may wait, and what paho may hold of it: the latest wins, so memory is bounded.

A stream also knows whether anyone listens: of a QoS 1 message an MQTT 5 broker reports when no subscription matched it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from paho.mqtt.properties import Properties

PayloadOutcome = Literal["published", "superseded", "failed", "refused"]

PROBE_PERIOD_NS = 1_000_000_000
"""So often a message of a stream asks whether anyone listens; a new subscriber is noticed as soon. Whole periods of the
clock, so that streams of the same frame ask together: a frame that only asks is reconstructed for nobody."""


@dataclass(frozen=True, slots=True, eq=False)
class Item:
    """One payload on its way."""

    payload: bytes
    seq: int


@dataclass(slots=True, eq=False)
class TopicSlot:
    """The latest-wins slot of one topic. Not locked: its owner guards it.

    Attributes
    ----------
    topic : str
    qos : int
    retain : bool
        A retained value is never done: the newest is sent again on every connection. It has no outcomes.
    most : int
        How many payloads paho may hold unsent (QoS 0) or unacknowledged (QoS 1).
    properties : Properties
    waiting : Item or None
        The slot.
    handed : list of Item
        What paho holds, oldest first.
    busy : bool
        A thread is between `take` and the end of its publish; only it may take next, which keeps the order.
    probed_ns : int or None
        When the latest message that asks for its listeners was sent, CLOCK_MONOTONIC; None for none.
    no_listener : bool
        The broker's latest answer was that there are none.
    refused : bool or None
        The broker's latest answer was that it does not take it; None before the first of a connection.
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
        """Nothing waits and nothing is under way."""
        return self.waiting is None and not self.handed

    def probe_due(self, now_ns: int) -> bool:
        """Whether the next message is to ask for listeners."""
        return self.probed_ns is None or now_ns // PROBE_PERIOD_NS != self.probed_ns // PROBE_PERIOD_NS

    def next_qos(self, now_ns: int) -> int:
        """QoS of the message that is sent now: 1 where it asks. Until the answer comes the one before holds."""
        if self.retain or not self.probe_due(now_ns):
            return self.qos
        self.probed_ns = now_ns
        return 1

    def put(self, item: Item) -> Item | None:
        """Fill the slot; the item that it displaced, or None."""
        displaced, self.waiting, self._newest = self.waiting, item, item
        return displaced

    def take(self) -> Item | None:
        """Claim the waiting item for publishing, or None if there is none or it is not yet its turn."""
        if self.busy or self.waiting is None or len(self.handed) >= self.most:
            return None
        item, self.waiting, self.busy = self.waiting, None, True
        self.handed.append(item)
        return item

    def done(self, item: Item) -> None:
        """Paho has sent (QoS 0) or delivered (QoS 1) the item."""
        self.handed.remove(item)

    def refuse(self, item: Item) -> Item | None:
        """Paho did not take the item: it waits again, or if a newer one does, it is returned as failed."""
        self.handed.remove(item)
        if self.waiting is None:
            self.waiting = item
            return None
        return None if self.retain else item

    def give_back(self) -> list[Item]:
        """Paho holds nothing any more. The newest item waits again unless a newer one does; the others have failed."""
        lost, self.handed = self.handed, []
        self.probed_ns, self.no_listener, self.refused = None, False, None
        if self.retain:
            self.waiting = self._newest
            return []
        if self.waiting is None and lost:
            self.waiting = lost.pop()
        return lost

    def drain(self) -> list[Item]:
        """Everything that is still here, oldest first; the outlet is empty afterwards."""
        left = [*self.handed, *([] if self.waiting is None else [self.waiting])]
        self.handed, self.waiting = [], None
        return left
