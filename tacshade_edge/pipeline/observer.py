"""The result of a frame, and the base class of the parts of the daemon that see frames."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import Any, ClassVar, Literal

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.settings import Settings
from tacshade_edge.types import Calibration, Frame, Need, Reconstruction

# Deadlines after the beginning of a stop, even if something hangs:
# a part that ends early leaves its time to the next.
THREADS_STOPPED_S, FRAMES_SENT_S = 0.9, 1.1
# Recorder and sessions end after the threads that add to them; then the robot's line, because they
# answer its commands; the link is last, because each part publishes how it ended.
RECORDED_S, STITCHED_S, SERIAL_STOPPED_S, LINK_STOPPED_S = 1.3, 1.4, 1.6, 1.9

# Longer than a camera's retries, so that a cable that is put back answers the command.
FRAME_TIMEOUT_NS = 5_000_000_000
WAITING_MAX = 16
Reply = Callable[[Any], None]
"""``reply(outcome)``, called once, from any thread:
a request's result or dictionary, or the reason for none.
"""
STOPPING = Reason(ReasonCode.DAEMON_STOPPED, "the daemon is stopping")
"""The answer to whatever waits or comes during a stop."""


def refuse_waiting(jobs: SimpleQueue[Any]) -> None:
    """Answer `STOPPING` to each (job, reply) in a queue that nobody takes from any more."""
    with contextlib.suppress(Empty):
        while True:
            if isinstance(job := jobs.get_nowait(), tuple):
                job[1](STOPPING)


@dataclass(frozen=True, slots=True)
class SourceState:
    """State of the frame source; `reason` is None when all is well."""

    state: Literal["streaming", "away", "unusable", "ended"]
    reason: Reason | None = None
    details: dict[str, str | int | float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class FrameResult:
    """A frame and its result.

    `calibration` is None before the first; `reconstruction` is None
    for a contact whose depth nobody needed.
    """

    frame: Frame
    calibration: Calibration | None
    reconstruction: Reconstruction | None
    step_ms: float = 0.0


class FrameObserver:
    """A part of the daemon that sees frames; subclasses override what they need,
    and the defaults do nothing.

    The thread `grab` calls `tap`, and `need` while nobody needs a frame; `reconstruct` calls `need`
    and `see`. None of these may wait. The main thread calls the others. `stop` must have returned
    `stop_s` after the beginning of a stop; the part with the earliest time stops first.
    """

    health_key: ClassVar[str] = ""
    stop_s: ClassVar[float] = THREADS_STOPPED_S

    def start(self) -> None:
        """Start; the pipeline's threads start afterwards."""

    @property
    def tap(self) -> Callable[[Frame], None] | None:
        """The function that takes each frame from the source, whatever its outcome;
        None while nothing takes them.
        """
        return None

    def need(self) -> Need:
        """How much of the next frame this part needs."""
        return Need.CONTACT

    def see(self, seen: FrameResult) -> None:
        """See a reconstructed frame."""

    def poll(self) -> None:
        """Do what is due; called several times a second."""

    def health(self) -> Mapping[str, Any] | None:
        """The report for ``health``, once a second."""
        return None

    def settings_changed(self, settings: Settings) -> None:
        """Apply settings that were read again."""

    def source_changed(self, source: SourceState) -> None:
        """Note a new state of the source, which is being published."""

    def stop(self, timeout_s: float) -> None:
        """Stop within this time."""


class FrameWaiters:
    """Commands, as the functions that answer them, that wait for the first frame taken after them;
    for any thread.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._lock = threading.Lock()
        self._waiting: list[tuple[int, Reply]] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, since_ns: int, reply: Reply) -> None:
        """Wait for a frame taken at `since_ns` or later; refuse at once if too many wait."""
        with self._lock:
            busy = len(self._waiting) >= WAITING_MAX
            if not busy:
                self._waiting.append((since_ns, reply))
        # Outside the lock: what replies may put another command.
        if busy:
            reply(Reason(ReasonCode.BUSY, f"{WAITING_MAX} {self._what}"))

    def take(self, t_ns: int) -> list[Reply]:
        """Remove and return those that wait for a frame of `t_ns`."""
        return self._remove(lambda since_ns: since_ns <= t_ns)

    def expire(self, now_ns: int) -> None:
        """Refuse those that have waited too long."""
        for reply in self._remove(lambda since_ns: now_ns - since_ns > FRAME_TIMEOUT_NS):
            reply(Reason(ReasonCode.TIMEOUT, f"no frame within {FRAME_TIMEOUT_NS / 1e9:.0f} s"))

    def refuse_all(self, reason: Reason) -> None:
        for reply in self._remove(lambda _: True):
            reply(reason)

    def _remove(self, due: Callable[[int], bool]) -> list[Reply]:
        # Without the lock, because every frame asks and mostly nothing waits. A command that
        # comes at this moment waits for the next frame.
        if not self._waiting:
            return []
        with self._lock:
            removed = [reply for since_ns, reply in self._waiting if due(since_ns)]
            self._waiting = [waiting for waiting in self._waiting if not due(waiting[0])]
        return removed
