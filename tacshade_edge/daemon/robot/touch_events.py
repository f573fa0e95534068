"""The newest touch on its way to the robot: a newer one replaces one that the port has not taken yet."""

from __future__ import annotations

import threading
from collections.abc import Callable

from tacshade_edge.protocol.results import TouchSwitched
from tacshade_edge.protocol.serial.commands import TouchAsked, TouchSeen, too_slow
from tacshade_edge.reasons import Reason
from tacshade_edge.types import Reconstruction

_JITTER = 0.25  # of a period: a frame that is this much early counts as on time


class TouchEvents:
    """What ``TOUCH ON`` requested, and the event that waits.

    Parameters
    ----------
    baud : int
        Baud rate of the line.
    wake : callable
        Called when an event waits to be sent.
    """

    def __init__(self, baud: int, wake: Callable[[], None]) -> None:
        self._baud = baud
        self._wake = wake
        self._lock = threading.Lock()
        self._asked: TouchAsked | None = None
        self._waiting: TouchSeen | None = None
        self._touches = False
        self._due_ns = 0
        self._events = self._dropped = 0

    @property
    def is_on(self) -> bool:
        """Whether the robot requested touches."""
        return self._asked is not None

    def switch(self, asked: TouchAsked | None) -> TouchSwitched | Reason:
        """Start what was requested, or stop; if the line is too slow, return the reason and change nothing."""
        if asked is not None and (reason := too_slow(asked, self._baud)) is not None:
            return reason
        with self._lock:
            self._asked, self._waiting, self._touches, self._due_ns = asked, None, False, 0
        return TouchSwitched(asked.rate_hz if asked else 0)

    def observe(self, result: Reconstruction) -> None:
        """Keep a frame's touch for the port if it is due; an invalid frame changes nothing."""
        if self._asked is None or not result.valid:
            return
        with self._lock:
            seen = self._due(self._asked, result)
            if seen is None:
                return
            self._dropped += self._waiting is not None
            self._waiting = seen
        self._wake()

    def take(self) -> TouchSeen | None:
        """Take the event that waits; None if there is none."""
        with self._lock:
            seen, self._waiting = self._waiting, None
            self._events += seen is not None
        return seen

    def as_dict(self) -> dict[str, int]:
        """For ``health``."""
        return {"touch_events": self._events, "touch_dropped": self._dropped}

    def _due(self, asked: TouchAsked | None, result: Reconstruction) -> TouchSeen | None:
        if asked is None:
            return None
        if not result.contact:
            ended, self._touches = self._touches, False
            return TouchSeen(result.seq, result.t_ns, False, tuple((n, None) for n in asked.names)) if ended else None
        if (touch := result.touch) is None:
            return None  # the frame was begun before the request
        self._touches = True
        period_ns = 1_000_000_000 // asked.rate_hz
        if result.t_ns < self._due_ns - _JITTER * period_ns:
            return None
        on_time = result.t_ns - self._due_ns < period_ns
        self._due_ns = (self._due_ns if on_time else result.t_ns) + period_ns
        return TouchSeen(result.seq, result.t_ns, True, tuple((n, touch.values.get(n)) for n in asked.names))
