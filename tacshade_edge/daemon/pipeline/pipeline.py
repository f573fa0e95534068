"""Source, reconstructor and observers with their two threads: the graph that every live command runs."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from tacshade_edge.daemon.pipeline.ledger import FrameLedger, Timings
from tacshade_edge.daemon.pipeline.mailbox import Mailbox
from tacshade_edge.daemon.pipeline.observer import FrameObserver, SourceState
from tacshade_edge.daemon.pipeline.workers import Grab, Reconstruct, Running
from tacshade_edge.devices.base import FrameSource
from tacshade_edge.types import Frame

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Crash:
    """An exception that ended a thread."""

    error: BaseException
    thread: str


class Pipeline:
    """The graph and its counts.

    Parameters
    ----------
    source : FrameSource
    running : Running
    observers : sequence of FrameObserver
        In the order in which they see a frame; one of them settles it in the ledger.
    ledger : FrameLedger
    timings : Timings
    report : callable
        Receives each new `SourceState`, in the grab thread.
    posed : callable or None
        Adds the pose to a frame.
    """

    def __init__(
        self,
        source: FrameSource,
        running: Running,
        observers: Sequence[FrameObserver],
        ledger: FrameLedger,
        timings: Timings,
        report: Callable[[SourceState], None],
        posed: Callable[[Frame], Frame] | None = None,
    ) -> None:
        self.ledger = ledger
        self._mailbox: Mailbox[Frame] = Mailbox()
        self.reconstruct = Reconstruct(running, self._mailbox, timings, observers, posed)
        self.grab = Grab(source, self._mailbox, ledger, report, observers, self.reconstruct.wants_next)
        # Daemon threads: a read or a step that hangs must not keep the process.
        self._threads = (
            threading.Thread(target=self.grab.run, name="grab", daemon=True),
            threading.Thread(target=self.reconstruct.run, name="reconstruct", daemon=True),
        )

    def start(self) -> None:
        """Start both threads."""
        for thread in self._threads:
            thread.start()

    def stop(self, timeout_s: float) -> bool:
        """Stop reading and finish the frame in the mailbox; return False if a thread did not end in time."""
        deadline = time.monotonic() + timeout_s
        grab, reconstruct = self._threads
        self.grab.stop()
        grab.join(timeout_s / 2)
        self._mailbox.close()
        reconstruct.join(max(0.0, deadline - time.monotonic()))
        left = [thread.name for thread in self._threads if thread.is_alive()]
        if left:
            _log.warning("stopping without %s, which did not finish within %.1f s", " and ".join(left), timeout_s)
        return not left


@contextmanager
def crashes_to(report: Callable[[Crash], None]) -> Iterator[None]:
    """Report every exception that ends any thread, so that the process never runs on with a thread missing."""

    def hook(crash: threading.ExceptHookArgs) -> None:
        if crash.exc_value is not None:
            report(Crash(crash.exc_value, crash.thread.name if crash.thread else "unknown"))

    before, threading.excepthook = threading.excepthook, hook
    try:
        yield
    finally:
        threading.excepthook = before
