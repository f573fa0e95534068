"""What ``TOUCH ON`` requested, and the newest touch on its way from a frame to the port."""

from __future__ import annotations

import threading
from collections.abc import Callable

from tacshade_edge.reasons import Reason
from tacshade_edge.robot.verbs import TouchAsked, TouchSeen, too_slow
from tacshade_edge.types import Reconstruction
from tacshade_edge.wire.results import TouchSwitched

# Of a period: a frame that is this much early counts as on time. Otherwise a camera whose rate is
# the requested one would, by the jitter of its time stamps, miss every other event.
_JITTER = 0.25
# Single unusable frames do not part the robot from what it knows.
_BRIDGED_NS = 100_000_000


class TouchEvents:
    """What ``TOUCH ON`` requested, and the newest touch:
    it replaces one that the port has not taken yet.
    """

    def __init__(self, baud: int, wake: Callable[[], None]) -> None:
        self._baud = baud
        self._wake = wake
        self._lock = threading.Lock()
        self._asked: TouchAsked | None = None
        self._waiting: TouchSeen | None = None
        self._touches = False
        self._known = True
        self._unusable_ns: int | None = None
        # Number and time of the latest frame since the request.
        self._latest: tuple[int, int] | None = None
        self._due_ns = 0
        self._events = self._dropped = 0

    @property
    def is_on(self) -> bool:
        return self._asked is not None

    def switch(self, asked: TouchAsked | None) -> TouchSwitched | Reason:
        """Start what was requested, or stop; if the line is too slow, change nothing."""
        if asked is not None and (reason := too_slow(asked, self._baud)) is not None:
            return reason
        with self._lock:
            self._asked, self._waiting, self._touches, self._due_ns = asked, None, False, 0
            self._known, self._unusable_ns, self._latest = True, None, None
        return TouchSwitched(asked.rate_hz if asked else 0)

    def observe(self, result: Reconstruction) -> None:
        """Keep a frame's touch for the port if it is due; of unusable frames, that there are."""
        # Without the lock: most robots never ask, and it is looked at again inside.
        if self._asked is None:
            return
        with self._lock:
            self._latest = result.seq, result.t_ns
            seen = self._due(self._asked, result) if result.valid else self._unusable(result.t_ns)
            self._keep(seen)
        # After the lock is released: the serial thread that this wakes takes it at once.
        if seen is not None:
            self._wake()

    def lost(self) -> None:
        """Note that no usable frames come: what the robot last heard no longer holds."""
        with self._lock:
            seen = self._unknown()
            self._keep(seen)
        if seen is not None:
            self._wake()

    def take(self) -> TouchSeen | None:
        with self._lock:
            seen, self._waiting = self._waiting, None
            self._events += seen is not None
        return seen

    def as_dict(self) -> dict[str, int]:
        return {"touch_events": self._events, "touch_dropped": self._dropped}

    def _keep(self, seen: TouchSeen | None) -> None:
        if seen is not None:
            self._dropped += self._waiting is not None
            self._waiting = seen

    def _unusable(self, t_ns: int) -> TouchSeen | None:
        """The event of unusable frames that have lasted; None for the others."""
        if self._unusable_ns is None:
            self._unusable_ns = t_ns
        return self._unknown() if t_ns - self._unusable_ns >= _BRIDGED_NS else None

    def _unknown(self) -> TouchSeen | None:
        """The event that nobody knows what touches; None if it has been sent."""
        if self._asked is None or self._latest is None or not self._known:
            return None
        # The next usable frame sends an event, even if nothing touches in it.
        self._known, self._touches, self._due_ns = False, True, 0
        values = tuple((name, None) for name in self._asked.names)
        return TouchSeen(*self._latest, contact=False, values=values, valid=False)

    def _due(self, asked: TouchAsked | None, result: Reconstruction) -> TouchSeen | None:
        if asked is None:
            return None
        self._known, self._unusable_ns = True, None
        if result.touch is None and not result.touched:
            if result.contact:
                return None  # the frame was begun before the request
            ended, self._touches = self._touches, False
            return (
                TouchSeen(
                    result.seq,
                    result.t_ns,
                    contact=False,
                    values=tuple((n, None) for n in asked.names),
                )
                if ended
                else None
            )
        self._touches = True
        period_ns = 1_000_000_000 // asked.rate_hz
        if result.t_ns < self._due_ns - _JITTER * period_ns:
            return None
        # A late frame does not shift the beat of the next ones, unless it is a whole period late:
        # then the events between are lost, and catching up would send a burst.
        on_time = result.t_ns - self._due_ns < period_ns
        self._due_ns = (self._due_ns if on_time else result.t_ns) + period_ns
        values = {} if result.touch is None else result.touch.values
        numbers = tuple((n, values.get(n)) for n in asked.names)
        return TouchSeen(result.seq, result.t_ns, result.contact, numbers, result.touched)
