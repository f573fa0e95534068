"""Combines the fingers' reports and decides when to publish the result. Pure: the caller passes in the time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from tacshade_edge.hand.held_object import HeldObject, with_motion
from tacshade_edge.protocol.hand import Finger, HandObjects, away
from tacshade_edge.reasons import Reason, ReasonCode

GATHER_NS: Final = 3_000_000
"""Longest wait of a finger's news for other fingers in contact, whose cameras do not expose together; a finger whose
next frame is due later is not waited for. Also the shortest time between two messages."""
QUIET_PERIOD_NS: Final = 100_000_000
"""Longest time between two messages, without contact and change."""
FIRST_NS: Final = 500_000_000
"""Longest wait for a silent finger before the first message to a new listener."""
STALLED_NS: Final = 3_000_000_000
"""A finger that has reported nothing for this long is away, as in `status/camera`."""

_STARTING: Final = away(Reason(ReasonCode.STARTING, "the hand has received nothing from this sensor yet"))
_STALLED: Final = away(Reason(ReasonCode.STALLED, "the sensor has sent no report"))


class HandAggregator:
    """The latest report of every finger, and when the next message is due."""

    def __init__(self, names: Sequence[str]) -> None:
        self._fingers = dict.fromkeys(names, _STARTING)
        self._heard_ns: dict[str, int | None] = dict.fromkeys(names)
        self._period_ns = dict.fromkeys(names, 0)  # between the latest two reports
        self._listened_ns: int | None = None
        self._published_ns = 0
        self._news: set[str] = set()
        self._news_ns = 0  # when the oldest news came
        self._seq = 0
        self._held = HeldObject()

    def listen(self, listened: bool, now_ns: int) -> None:
        """Note whether anybody listens; when that begins, earlier reports no longer count."""
        if not listened:
            self._listened_ns = None
        elif self._listened_ns is None:
            self._listened_ns, self._published_ns, self._held = now_ns, 0, HeldObject()
            for name, finger in self._fingers.items():
                self._heard_ns[name] = None
                if finger.state != "away":
                    self._fingers[name] = _STARTING

    def hear(self, name: str, finger: Finger, now_ns: int) -> None:
        """Store a finger's report."""
        before = self._fingers[name]
        self._period_ns[name] = now_ns - (self._heard_ns[name] or now_ns)
        self._fingers[name], self._heard_ns[name] = finger, now_ns
        if finger.state == "contact" or finger.state != before.state:
            self._news_ns = self._news_ns if self._news else now_ns
            self._news.add(name)

    def due_ns(self) -> int | None:
        """When the next message is due; None while nobody listens."""
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
        """Make the next message."""
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
