"""What other threads and signal handlers report to the main thread."""

from __future__ import annotations

from queue import SimpleQueue
from typing import Literal

from tacshade_edge.daemon.active_profile import Step
from tacshade_edge.pipeline.observer import Reply, SourceState, refuse_waiting
from tacshade_edge.pipeline.pipeline import Crash
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.wire.requests import Request

EVENTS_MAX = 16

Event = Literal["stop", "reload", "recorded"] | Crash | SourceState | tuple[Request, Reply] | Step


class Events:
    """The main thread's queue; any thread and a signal handler may `put`."""

    def __init__(self) -> None:
        # SimpleQueue: the one queue that a signal handler may put into. It runs between two
        # instructions of the main thread, which may hold the lock of any other.
        self._queue: SimpleQueue[Event] = SimpleQueue()
        self.put = self._queue.put
        self._closed = False

    def request(self, request: Request, reply: Reply) -> None:
        """Put a request, or refuse it if too many events wait: clients may send any number."""
        # Two threads may find the same last place, so a few more than `EVENTS_MAX` can wait. What
        # is no request is rare, and never refused.
        if self._queue.qsize() >= EVENTS_MAX:
            text = f"busy: {EVENTS_MAX} requests are already waiting; try again"
            reply(Reason(ReasonCode.BUSY, text))
        else:
            self._queue.put((request, reply))
            if self._closed:  # nobody takes it any more
                refuse_waiting(self._queue)

    def close(self) -> None:
        """Refuse the requests that wait, and from now on those that come."""
        self._closed = True
        refuse_waiting(self._queue)

    def get(self, timeout_s: float) -> Event:
        """Wait for an event. Raises queue.Empty."""
        return self._queue.get(timeout=max(0.0, timeout_s))
