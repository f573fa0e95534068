"""The daemon's own grab thread and mailbox with a recorder behind them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Literal

from tacshade_edge.daemon.ledger import FrameLedger
from tacshade_edge.daemon.mailbox import Mailbox
from tacshade_edge.daemon.pipeline import Crash, crashes_to
from tacshade_edge.daemon.workers import Grab, SourceState
from tacshade_edge.devices.base import FrameSource
from tacshade_edge.devices.recorder import Recorder
from tacshade_edge.types import Frame

POLL_S, STOP_S = 0.1, 1.0
Ending = Literal["time", "stopped", "source ended", "disk"]


def record(
    source: FrameSource,
    recorder: Recorder,
    *,
    seconds: float,
    stopped: Callable[[], bool],
    told: Callable[[SourceState], None],
) -> Ending:
    """Record until the time is over, someone stops it, the source ends, or the disk is down to its floor.

    A source that is away is waited for, as the daemon does; a disk that is too slow loses frames, which are counted in
    ``recording.json`` as superseded.

    Raises
    ------
    ConfigError
        The source can never work.
    DeviceError
        The folder cannot be written.
    """
    ledger, mailbox = FrameLedger(), Mailbox[Frame]()
    events: SimpleQueue[Crash | SourceState | Literal["disk"]] = SimpleQueue()
    grab = Grab(source, mailbox, ledger, events.put)
    first: list[Frame] = []

    def write() -> None:
        while (frame := mailbox.take()) is not None:
            if not recorder.add(frame):
                ledger.settle(frame.seq, "failed")
                events.put("disk")
                return
            ledger.settle(frame.seq, "published")
            if not first:
                first.append(frame)

    grabbing = threading.Thread(target=grab.run, name="grab", daemon=True)
    writing = threading.Thread(target=write, name="write", daemon=True)
    with crashes_to(events.put):
        grabbing.start()
        writing.start()
        try:
            ending = _wait(events, time.monotonic() + seconds, stopped, told)
        finally:
            grab.stop()
            grabbing.join(STOP_S)  # a read that hangs is left behind
            mailbox.close()
            writing.join()
    while not events.empty():  # what the last frame met
        event = events.get()
        if isinstance(event, Crash):
            raise event.error
        ending = "disk" if event == "disk" else ending
    counts = ledger.counts()
    recorder.finish(
        {
            "source": source.describe(),
            "frames": recorder.frames,
            "superseded": counts.superseded,
            "failed": counts.failed,
            "source_dropped": source.dropped,
            "first_t_ns": first[0].t_ns if first else None,
            "first_wall_ns": first[0].wall_ns if first else None,
            "ending": ending,
        }
    )
    return ending


def _wait(
    events: SimpleQueue[Crash | SourceState | Literal["disk"]],
    deadline_s: float,
    stopped: Callable[[], bool],
    told: Callable[[SourceState], None],
) -> Ending:
    """What ended the recording. Raises what left a thread."""
    while time.monotonic() < deadline_s:
        if stopped():
            return "stopped"
        try:
            event = events.get(timeout=POLL_S)
        except Empty:
            continue
        if isinstance(event, Crash):
            raise event.error
        if event == "disk":
            return "disk"
        if isinstance(event, SourceState):
            told(event)
            if event.state == "ended":
                return "source ended"
    return "time"
