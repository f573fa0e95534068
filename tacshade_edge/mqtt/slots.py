"""What waits for the broker on one topic, and what paho holds of it: the latest wins."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple

from paho.mqtt.properties import Properties

PROBE_PERIOD_NS: Final = 1_000_000_000
"""Period in ns at which a message of a stream probes for subscribers, so a new one is noticed
within it. Whole periods of the clock, so that the streams of a frame probe together: a frame that
only probes is reconstructed for nobody.
"""


# Compared by identity: two frames may have equal payloads.
@dataclass(frozen=True, slots=True, eq=False)
class Item:
    payload: bytes
    seq: int


@dataclass(slots=True, eq=False)
class Slot:
    """The payloads of one topic that wait or that paho holds: the latest wins."""

    topic: str
    qos: int
    # The newest value is sent again on every connection, and has no outcome.
    retain: bool
    # How many payloads paho may hold unsent (QoS 0) or unacknowledged (QoS 1).
    most: int
    properties: Properties
    waiting: Item | None = None
    handed: list[Item] = field(default_factory=list)
    newest: Item | None = None
    # Answers of this connection's broker:
    probed_ns: int | None = None
    no_listener: bool = False
    refused: bool | None = None

    def probe_due(self, now_ns: int) -> bool:
        return (
            self.probed_ns is None or now_ns // PROBE_PERIOD_NS != self.probed_ns // PROBE_PERIOD_NS
        )

    def next_qos(self, now_ns: int) -> int:
        """Return the QoS of the message being sent: 1 for a probe.

        Until its answer comes, the previous one holds.
        """
        if self.retain or not self.probe_due(now_ns):
            return self.qos
        self.probed_ns = now_ns
        return 1

    def disconnected(self) -> list[Item]:
        """Take back what paho held: the newest waits again unless a newer one does;
        return the others, which failed.
        """
        lost, self.handed = self.handed, []
        self.probed_ns, self.no_listener, self.refused = None, False, None
        if self.retain:
            self.waiting = self.newest
            return []
        # Only the newest: older frames would arrive late, and a subscriber would see time go back.
        if self.waiting is None and lost:
            self.waiting = lost.pop()
        return lost


class Sent(NamedTuple):
    """A message that paho holds: its slot and item, or None for a reply or an event."""

    slot: Slot | None
    item: Item | None
    qos: int
    size: int
