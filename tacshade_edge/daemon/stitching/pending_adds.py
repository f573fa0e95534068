"""Commands to add a press that wait for the first frame taken after them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from tacshade_edge.protocol.results import SessionResult
from tacshade_edge.reasons import Reason, ReasonCode

ADD_TIMEOUT_NS = 5_000_000_000
WAITING_MAX = 16

Reply = Callable[[SessionResult | Reason], None]
"""``reply(outcome)``, called once: a command's result, or the reason that there is none."""


@dataclass(frozen=True, slots=True)
class _PendingAdd:
    since_ns: int
    reply: Reply


class PendingAdds:
    """A bounded list of replies, for any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pending: list[_PendingAdd] = []

    def __len__(self) -> int:
        return len(self._pending)

    def put(self, since_ns: int, reply: Reply) -> None:
        """Wait for a frame taken at `since_ns` or later; refuse at once if too many wait."""
        with self._lock:
            busy = len(self._pending) >= WAITING_MAX
            if not busy:
                self._pending.append(_PendingAdd(since_ns, reply))
        if busy:
            reply(Reason(ReasonCode.BUSY, f"{WAITING_MAX} presses are already waiting for a frame"))

    def take(self, t_ns: int) -> list[Reply]:
        """Remove and return the replies that wait for a frame of `t_ns`."""
        return self._remove(lambda pending: pending.since_ns <= t_ns)

    def expire(self, now_ns: int) -> None:
        """Refuse the commands that have waited too long."""
        for reply in self._remove(lambda pending: now_ns - pending.since_ns > ADD_TIMEOUT_NS):
            reply(Reason(ReasonCode.TIMEOUT, f"no frame within {ADD_TIMEOUT_NS / 1e9:.0f} s"))

    def refuse_all(self, reason: Reason) -> None:
        """Refuse all commands that wait."""
        for reply in self._remove(lambda _: True):
            reply(reason)

    def _remove(self, due: Callable[[_PendingAdd], bool]) -> list[Reply]:
        with self._lock:
            removed = [pending for pending in self._pending if due(pending)]
            self._pending = [pending for pending in self._pending if pending not in removed]
        return [pending.reply for pending in removed]
