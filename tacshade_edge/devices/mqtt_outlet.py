"""What of one topic may wait, and what paho may hold of it: the latest wins, so memory is bounded."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from paho.mqtt.properties import Properties

Outcome = Literal["published", "superseded", "failed"]


@dataclass(frozen=True, slots=True, eq=False)
class Item:
    """One payload on its way."""

    payload: bytes
    seq: int


@dataclass(slots=True, eq=False)
class Outlet:
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
    """

    topic: str
    qos: int
    retain: bool
    most: int
    properties: Properties
    waiting: Item | None = None
    handed: list[Item] = field(default_factory=list)
    busy: bool = False
    _newest: Item | None = None

    @property
    def idle(self) -> bool:
        """Nothing waits and nothing is under way."""
        return self.waiting is None and not self.handed

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
