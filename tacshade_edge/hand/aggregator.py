"""Combines what the fingers report, and decides when to publish it. Pure: it is given the time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from tacshade_edge.hand.held_object import HeldObject, with_motion
from tacshade_edge.protocol.hand import Finger, HandObjects, away
from tacshade_edge.reasons import Reason, ReasonCode

GATHER_NS: Final = 3_000_000
"""News of one finger waits at most so long for that of the others in contact, whose cameras do not expose together, and
not at all for one whose next frame is due later; so long at least after the message before."""
QUIET_PERIOD_NS: Final = 100_000_000
"""Between two messages at most: without contact and change."""
FIRST_NS: Final = 500_000_000
"""So long after somebody began to listen the first message waits for a silent finger."""
STALLED_NS: Final = 3_000_000_000
"""A finger that reported nothing for so long is away; as `status/camera` does."""

_STARTING: Final = away(Reason(ReasonCode.STARTING, "the hand has received nothing from this sensor yet"))
_STALLED: Final = away(Reason(ReasonCode.STALLED, "the sensor reports nothing"))


class HandAggregator:
    """The latest of every finger."""

    def __init__(self, names: Sequence[str]) -> None:
        self._fingers = dict.fromkeys(names, _STARTING)
        self._heard_ns: dict[str, int | None] = dict.fromkeys(names)
        self._period_ns = dict.fromkeys(names, 0)  # between the latest two reports
        self._listened_ns: int | None = None
        self._published_ns = 0
        self._news: set[str] = set()
        self._news_ns = 0  # the oldest
        self._seq = 0
        self._held = HeldObject()

    def listen(self, listened: bool, now_ns: int) -> None:
        """Somebody listens, or nobody does; when it begins, what was reported before is no news any more."""
        if not listened:
            self._listened_ns = None
        elif self._listened_ns is None:
            self._listened_ns, self._published_ns, self._held = now_ns, 0, HeldObject()
            for name, finger in self._fingers.items():
                self._heard_ns[name] = None
                if finger.state != "away":
                    self._fingers[name] = _STARTING

    def hear(self, name: str, finger: Finger, now_ns: int) -> None:
        """Take what a finger reports."""
        before = self._fingers[name]
        self._period_ns[name] = now_ns - (self._heard_ns[name] or now_ns)
        self._fingers[name], self._heard_ns[name] = finger, now_ns
        if finger.state == "contact" or finger.state != before.state:
            self._news_ns = self._news_ns if self._news else now_ns
            self._news.add(name)

    def due_ns(self) -> int | None:
        """When the next message is to go; None while nobody listens."""
        since_ns = self._listened_ns
        if since_ns is None:
            return None
        if self._published_ns == 0 and None in self._heard_ns.values():
            return since_ns + FIRST_NS
        if not self._news:
            return self._published_ns + QUIET_PERIOD_NS if self._published_ns else since_ns
        until_ns = self._news_ns + GATHER_NS
        waits = any(
            finger.state == "contact"
            and name not in self._news
            and (self._heard_ns[name] or 0) + self._period_ns[name] <= until_ns
            for name, finger in self._fingers.items()
        )
        return max(until_ns if waits else self._news_ns, self._published_ns + GATHER_NS)

    def message(self, now_ns: int, wall_ns: int) -> HandObjects:
        """The next message."""
        for name, finger in self._fingers.items():
            heard_ns = self._heard_ns[name] or self._listened_ns or now_ns
            if finger.state != "away" and now_ns - heard_ns > STALLED_NS:
                self._fingers[name] = _STALLED
        motion = self._held.step(self._fingers, now_ns)
        fingers = {}
        for name, finger in self._fingers.items():
            aged = None if finger.t_ns is None else round((now_ns - finger.t_ns) / 1e6, 3)
            fingers[name] = replace(with_motion(finger, motion), age_ms=aged)
        message = HandObjects(t_ns=now_ns, wall_ns=wall_ns, seq=self._seq, fingers=fingers)
        self._published_ns = now_ns
        self._news.clear()
        self._seq += 1
        return message
