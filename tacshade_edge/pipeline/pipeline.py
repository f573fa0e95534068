"""Source, reconstructor and observers with their two threads:
the graph that every live command runs.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.errors import DecodeError, DeviceError
from tacshade_edge.pipeline.ledger import FrameLedger, StageTimer, Timings
from tacshade_edge.pipeline.observer import FrameObserver, FrameResult, SourceState
from tacshade_edge.reasons import Reason
from tacshade_edge.sensor.contact.tracking import ContactTracker
from tacshade_edge.sensor.reconstruct import Reconstructor, step_and_track
from tacshade_edge.types import Frame, HeightMap, Need, ObjectCloud, Reconstruction

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Crash:
    """An exception that ended a thread."""

    error: BaseException
    thread: str


class Pipeline:
    """The graph.

    One of the `observers`, which see a frame in this order, settles it in the ledger. `running` is
    the next frame's reconstructor, or the reason that there is none; `report` receives each new
    `SourceState` in the grab thread.
    """

    def __init__(
        self,
        source: FrameSource,
        running: Callable[[], Reconstructor | Reason],
        observers: Sequence[FrameObserver],
        ledger: FrameLedger,
        timings: Timings,
        report: Callable[[SourceState], None],
        posed: Callable[[Frame], Frame] | None = None,
    ) -> None:
        self.ledger = ledger
        self._mailbox: Mailbox[Frame] = Mailbox()
        self.reconstruct = Reconstruct(running, self._mailbox, timings, observers, posed)
        self.grab = Grab(
            source, self._mailbox, ledger, report, observers, self.reconstruct.wants_next
        )
        # Daemon threads: a read or a step that hangs must not keep the process.
        self._threads = (
            threading.Thread(target=self.grab.run, name="grab", daemon=True),
            threading.Thread(target=self.reconstruct.run, name="reconstruct", daemon=True),
        )

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def stop(self, timeout_s: float) -> bool:
        """Stop reading and finish the frame in the mailbox;
        return False if a thread did not end in time.
        """
        deadline = time.monotonic() + timeout_s
        grab, reconstruct = self._threads
        self.grab.stop()
        # Half of the time at most: a driver may hang in a read, and the frame that is already in
        # the mailbox should still be published.
        grab.join(timeout_s / 2)
        self._mailbox.close()
        reconstruct.join(max(0.0, deadline - time.monotonic()))
        left = [thread.name for thread in self._threads if thread.is_alive()]
        if left:
            _log.warning(
                "stopping without %s, which did not finish within %.1f s",
                " and ".join(left),
                timeout_s,
            )
        return not left


@contextmanager
def crashes_to(report: Callable[[Crash], None]) -> Iterator[None]:
    """Report every exception that ends any thread,
    so that the process never runs on with a thread missing.
    """

    def hook(crash: threading.ExceptHookArgs) -> None:
        if crash.exc_value is not None:
            report(Crash(crash.exc_value, crash.thread.name if crash.thread else "unknown"))

    before, threading.excepthook = threading.excepthook, hook
    try:
        yield
    finally:
        threading.excepthook = before


T = TypeVar("T")


class Mailbox(Generic[T]):
    """One slot between two threads: the newest item wins.

    Two locks replace a condition, so that the taker never wakes only to wait for `put`.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ready = threading.Lock()  # held while there is nothing to take
        self._ready.acquire()
        self._item: T | None = None
        self._closed = False

    def put(self, item: T) -> T | None:
        """Leave `item` for the taker.

        The caller accounts for what it gets back: replaced, or refused.
        """
        with self._lock:
            if self._closed:
                return item
            replaced, self._item = self._item, item
        # Only for the first item: while one lies there, the taker has not come yet, and the lock
        # is free already.
        if replaced is None:
            self._ready.release()
        return replaced

    def take(self) -> T | None:
        """Wait for the item; None once the mailbox is closed and empty."""
        self._ready.acquire()
        with self._lock:
            item, self._item = self._item, None
            # Once closed, every further `take` must return as well, so the lock stays free.
            if self._closed:
                self._ready.release()
        return item

    def close(self) -> None:
        """Let the taker have the item in the slot, then None."""
        with self._lock:
            wakes = self._item is None and not self._closed
            self._closed = True
        if wakes:
            self._ready.release()


FIRST_RETRY_S, LONGEST_RETRY_S = 0.1, 1.0
LOOK_EVERY = 6
"""One in this many frames that nobody needs is examined, for the sensor's state and for a reference
that follows. After an invalid frame every one is: otherwise skipped frames would hide that none can
be used. A skipped frame costs only the source's `skip`: it is neither copied nor passed to another
thread.
"""


class Grab:
    """Reads the source until it ends, and reopens a lost one with growing pauses.

    `wants_next` is called once for each frame, before it comes: whether it goes to the mailbox.
    """

    def __init__(
        self,
        source: FrameSource,
        mailbox: Mailbox[Frame],
        ledger: FrameLedger,
        report: Callable[[SourceState], None],
        observers: Sequence[FrameObserver] = (),
        wants_next: Callable[[], bool] = lambda: True,
    ) -> None:
        self._source = source
        self._mailbox = mailbox
        self._ledger = ledger
        self._report = report
        self._stop = threading.Event()
        self._reported: SourceState | None = None
        self.retry_s = FIRST_RETRY_S
        self.last_frame_ns = 0  # CLOCK_MONOTONIC; 0 before the first
        self.attempts = 0  # openings, and frames that could not be decoded
        self._tapping = [each for each in observers if type(each).tap is not FrameObserver.tap]
        self._wants_next = wants_next

    def stop(self) -> None:
        self._stop.set()

    def run(self) -> None:
        while not self._stop.is_set():
            self.attempts += 1
            try:
                self._source.open()
                if self._read_all():
                    self._change_state(SourceState("ended"))
                    return
            except DeviceError as error:
                self._change_state(SourceState("away", error.reason))
            finally:
                self._source.close()
            self._stop.wait(self.retry_s)
            self.retry_s = min(2 * self.retry_s, LONGEST_RETRY_S)

    def _read_all(self) -> bool:
        """Read until `stop` (False) or the end (True). Only a frame proves that a device works."""
        while not self._stop.is_set():
            wanted = self._wants_next()
            try:
                went_on = (
                    self._read(wanted=wanted)
                    if wanted or any(each.tap for each in self._tapping)
                    else self._skip()
                )
            except DecodeError as error:
                _log.debug("%s", error)
                self.attempts += 1
                self._ledger.passed("failed")
                # Before any frame it is the source's state; in a stream it only counts.
                if self._reported is None:
                    self._change_state(SourceState("away", error.reason))
                continue
            if not went_on:
                return True
            self.last_frame_ns = time.monotonic_ns()
            if self._reported is None or self._reported.state != "streaming":
                # Not where it is opened: a lost camera may open, and only a frame proves that it
                # works.
                self.retry_s = FIRST_RETRY_S
                self._change_state(SourceState("streaming", None, self._source.describe()))
        return False

    def _read(self, *, wanted: bool) -> bool:
        """Read the next frame and pass it on; False at the end."""
        if (frame := self._source.read()) is None:
            return False
        # Before the mailbox, where a newer frame may replace it: a recording gets every frame.
        for each in self._tapping:
            if tap := each.tap:
                tap(frame)
        if wanted:
            self._ledger.captured(frame.seq)
            if (superseded := self._mailbox.put(frame)) is not None:
                # Counted here, because nobody else will see it.
                self._ledger.settle(superseded.seq, "superseded")
        else:
            self._ledger.passed("unasked")
        return True

    def _skip(self) -> bool:
        """Skip the next frame; False at the end."""
        if went_on := self._source.skip():
            self._ledger.passed("unasked")
        return went_on

    def _change_state(self, state: SourceState) -> None:
        if state != self._reported:
            self._reported = state
            self._report(state)


class Reconstruct:
    """Takes the newest frame, reconstructs it, adds its pose, which may have come by then,
    and shows it to all.
    """

    def __init__(
        self,
        running: Callable[[], Reconstructor | Reason],
        mailbox: Mailbox[Frame],
        timings: Timings,
        observers: Sequence[FrameObserver],
        posed: Callable[[Frame], Frame] | None = None,
    ) -> None:
        self._running = running
        self._tracker = ContactTracker()
        self.taken = self.processed = 0  # frames; they differ while one is in progress
        self._timer = StageTimer()
        self._mailbox = mailbox
        self._timings = timings
        # Only those that override the method: the other calls cost 3 µs a frame.
        self._needs = [each.need for each in observers if type(each).need is not FrameObserver.need]
        self._sees = [each.see for each in observers if type(each).see is not FrameObserver.see]
        self._look_every = 1
        self._passed = 0  # frames since the latest that was examined
        self._posed = posed

    @property
    def stages(self) -> int:
        """Number of stages that have ended, of all frames."""
        return self._timer.ended

    def run(self) -> None:
        while (frame := self._mailbox.take()) is not None:
            self.taken += 1
            self._process(frame, self._need())
            self.processed += 1

    def wants_next(self) -> bool:
        """Whether to examine the next frame, because it is needed or its turn has come.

        `grab` calls this once each.
        """
        self._passed += 1
        if self._passed < self._look_every and self._need() is Need.CONTACT:
            return False
        self._passed = 0
        return True

    def _process(self, frame: Frame, need: Need) -> None:
        # Asked once a frame: the main thread may replace it at any time.
        timer, reconstructor = self._timer, self._running()
        timer.begin()
        began_ns = timer.last_ns
        timer.ms["wait"] = (began_ns - frame.t_ns) / 1e6
        made: Reconstruction | None
        if isinstance(reconstructor, Reason):
            calibration, made = None, _not_reconstructed(frame, reconstructor)
        else:
            calibration = reconstructor.calibration
            made = step_and_track(reconstructor, self._tracker, frame, timer.mark, need)
        step_ms = (time.monotonic_ns() - began_ns) / 1e6
        # After the reconstruction, because by then the pose that follows the frame may have come.
        seen = FrameResult(self._posed(frame) if self._posed else frame, calibration, made, step_ms)
        for see in self._sees:
            see(seen)
        usable = made is None or made.valid
        # Read by `grab`, which may use the old value for a frame more.
        self._look_every = LOOK_EVERY if usable else 1
        timer.mark("deliver")
        timer.ms["latency"] = (timer.last_ns - frame.t_ns) / 1e6
        self._timings.add(timer.ms)

    def _need(self) -> Need:
        need = Need.CONTACT
        for asked in self._needs:
            if (more := asked()) is not Need.CONTACT:  # a union of flags is expensive
                need |= more
        return need


def _not_reconstructed(frame: Frame, reason: Reason) -> Reconstruction:
    """The invalid result of a frame whose disc is unknown."""
    height = HeightMap(np.zeros((0, 0), np.float32), np.zeros((0, 0), np.bool_), 0.0, 0.0, 1.0)
    cloud = ObjectCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16))
    return Reconstruction(
        seq=frame.seq,
        t_ns=frame.t_ns,
        wall_ns=frame.wall_ns,
        profile="",
        valid=False,
        reason=reason,
        contact=False,
        saturated=False,
        degraded=None,
        height=height,
        cloud=cloud,
    )
