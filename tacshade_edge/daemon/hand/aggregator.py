"""Combines what the fingers report, and decides when to publish it. Pure: it is given the time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import msgspec

from tacshade_edge.protocol.hand import Finger, HandObjects, away
from tacshade_edge.reasons import Reason, ReasonCode

PERIOD_NS: Final = 1_000_000_000 // 60
"""Between two messages at least."""
QUIET_PERIOD_NS: Final = 100_000_000
"""Between two messages at most: without contact and change."""
FIRST_NS: Final = 500_000_000
"""So long after somebody began to listen the first message waits for a silent finger."""
STALLED_NS: Final = 3_000_000_000
"""A finger that reported nothing for so long is away; as `status/camera` does."""

_STARTING: Final = away(Reason(ReasonCode.STARTING, "nothing is known yet"))
_STALLED: Final = away(Reason(ReasonCode.STALLED, "it reports nothing"))


class HandAggregator:
    """The latest of every finger."""

    def __init__(self, names: Sequence[str]) -> None:
        self._fingers = dict.fromkeys(names, _STARTING)
        self._heard_ns: dict[str, int | None] = dict.fromkeys(names)
        self._listened_ns: int | None = None
        self._published_ns = 0
        self._changed = False
        self._seq = 0

    def listen(self, listened: bool, now_ns: int) -> None:
        """Somebody listens, or nobody does; when it begins, what was reported before is no news any more."""
        if not listened:
            self._listened_ns = None
        elif self._listened_ns is None:
            self._listened_ns, self._changed, self._published_ns = now_ns, True, 0
            for name, finger in self._fingers.items():
                self._heard_ns[name] = None
                if finger.state != "away":
                    self._fingers[name] = _STARTING

    def hear(self, name: str, finger: Finger, now_ns: int) -> None:
        """Take what a finger reports."""
        before = self._fingers[name]
        self._fingers[name], self._heard_ns[name] = finger, now_ns
        self._changed |= finger.state == "contact" or finger.state != before.state

    def due_ns(self) -> int | None:
        """When the next message is to go; None while nobody listens."""
        since_ns = self._listened_ns
        if since_ns is None:
            return None
        if self._published_ns == 0 and None in self._heard_ns.values():
            return since_ns + FIRST_NS
        return self._published_ns + (PERIOD_NS if self._changed else QUIET_PERIOD_NS)

    def message(self, now_ns: int, wall_ns: int) -> HandObjects:
        """The next message."""
        fingers = {}
        for name, finger in self._fingers.items():
            heard_ns = self._heard_ns[name] or self._listened_ns or now_ns
            if finger.state != "away" and now_ns - heard_ns > STALLED_NS:
                finger = self._fingers[name] = _STALLED
            aged = None if finger.t_ns is None else round((now_ns - finger.t_ns) / 1e6, 3)
            fingers[name] = msgspec.structs.replace(finger, age_ms=aged)
        message = HandObjects(t_ns=now_ns, wall_ns=wall_ns, seq=self._seq, fingers=fingers)
        self._published_ns, self._changed = now_ns, False
        self._seq += 1
        return message
