"""What the thread `stitch` has to do, job after job, each with one answer: its outcome, or the
refusal of a stop.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue

from tacshade_edge.errors import DeviceError
from tacshade_edge.pipeline.observer import STOPPING, Reply, refuse_waiting
from tacshade_edge.reasons import Reason
from tacshade_edge.wire.results import SessionResult

Job = Callable[[], SessionResult]
_STOP = "stop"


class SessionJobs:
    """Any thread puts jobs; one takes, does and answers them."""

    def __init__(self) -> None:
        self._waiting: SimpleQueue[tuple[Job, Reply] | str] = SimpleQueue()
        self._lock = threading.Lock()
        self._at_work: Reply | None = None

    def __len__(self) -> int:
        return self._waiting.qsize()

    def put(self, job: Job, reply: Reply) -> None:
        self._waiting.put((job, reply))

    def stop(self) -> None:
        """Let `next` return None after the jobs that wait now."""
        self._waiting.put(_STOP)

    def refuse_all(self) -> None:
        """Answer `STOPPING` to the job at work, whose outcome nobody gets any more, and to those
        that wait.
        """
        if (reply := self._take_at_work()) is not None:
            reply(STOPPING)
        refuse_waiting(self._waiting)
        self.stop()

    # The thread calls these.

    def next(self, timeout_s: float | None) -> Job | None:
        """The next job, or None after a stop. Raises TimeoutError."""
        try:
            taken = self._waiting.get(timeout=timeout_s)
        except Empty:
            raise TimeoutError from None
        if isinstance(taken, str):
            return None
        with self._lock:
            self._at_work = taken[1]
        return taken[0]

    def check_wanted(self) -> None:
        """Raise DeviceError if the job at work has been refused, and must change nothing more."""
        if self._at_work is None:
            raise DeviceError(STOPPING.text, code=STOPPING.code)

    def answer(self, outcome: SessionResult | Reason) -> None:
        """Answer the job at work, unless it has been refused."""
        if (reply := self._take_at_work()) is not None:
            reply(outcome)

    def _take_at_work(self) -> Reply | None:
        with self._lock:
            reply, self._at_work = self._at_work, None
        return reply
