"""The two threads that frames pass through: `Grab` fills the mailbox, `Reconstruct` empties it."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from tacshade_edge.core.contact.tracking import ContactTracker, follow
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.daemon.pipeline.ledger import FrameLedger, FrameOutcome, Timings
from tacshade_edge.daemon.pipeline.mailbox import Mailbox
from tacshade_edge.devices.base import FrameSource
from tacshade_edge.errors import DecodeError, DeviceError
from tacshade_edge.reasons import Reason
from tacshade_edge.types import Calibration, Frame, HeightMap, Need, ObjectCloud, Reconstruction

_log = logging.getLogger(__name__)

FIRST_RETRY_S, LONGEST_RETRY_S = 0.1, 1.0


@dataclass(frozen=True, slots=True)
class SourceState:
    """How the frame source is; `reason` is None when all is well."""

    state: Literal["streaming", "away", "unusable", "ended"]
    reason: Reason | None = None
    details: dict[str, str | int | float] = field(default_factory=dict)


class Grab:
    """Reads the source for ever; a lost one is opened again with growing pauses.

    Parameters
    ----------
    source : FrameSource
    mailbox : Mailbox of Frame
        Newest wins: the source is never kept waiting.
    ledger : FrameLedger
    report : callable
        Called in this thread with each new `SourceState`, never twice with the same.
    """

    def __init__(
        self,
        source: FrameSource,
        mailbox: Mailbox[Frame],
        ledger: FrameLedger,
        report: Callable[[SourceState], None],
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
        self.tap: Callable[[Frame], None] | None = None  # sees every captured frame; must not wait

    def stop(self) -> None:
        """Make `run` return after the read that it is in."""
        self._stop.set()

    def run(self) -> None:
        """Read until `stop`, or until a finite source ends."""
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
            try:
                frame = self._source.read()
            except DecodeError as error:
                _log.debug("%s", error)
                self.attempts += 1
                self._ledger.undecodable()
                if self._reported is None:  # nothing to see from the start; in a stream it is one counted frame
                    self._change_state(SourceState("away", error.reason))
                continue
            if frame is None:
                return True
            self._ledger.captured(frame.seq)
            self.last_frame_ns = time.monotonic_ns()
            if tap := self.tap:
                tap(frame)
            if (superseded := self._mailbox.put(frame)) is not None:
                self._ledger.settle(superseded.seq, "superseded")
            if self._reported is None or self._reported.state != "streaming":
                self.retry_s = FIRST_RETRY_S
                self._change_state(SourceState("streaming", None, self._source.describe()))
        return False

    def _change_state(self, state: SourceState) -> None:
        if state != self._reported:
            self._reported = state
            self._report(state)


class Sink(Protocol):
    """Where reconstructions go."""

    def need(self) -> Need:
        """How much of the next frame is asked for."""
        ...

    def deliver(
        self, frame: Frame, result: Reconstruction | None, calibration: Calibration | None
    ) -> FrameOutcome | None:
        """Pass a result on without waiting (None: a contact without its depth); None: it will be settled later.

        Without a calibration each result is invalid.
        """
        ...


class Reconstruct:
    """Takes the newest frame, reconstructs it, delivers it.

    Parameters
    ----------
    reconstructor : Reconstructor or Reason
        Or why there is none: no frame is valid then. May be replaced at any time through the attribute; the next frame
        uses the new one.
    mailbox, ledger, timings, sink
    """

    def __init__(
        self,
        reconstructor: Reconstructor | Reason,
        mailbox: Mailbox[Frame],
        ledger: FrameLedger,
        timings: Timings,
        sink: Sink,
    ) -> None:
        self.reconstructor = reconstructor
        self.watch: Callable[[Frame, Reconstruction], None] | None = None
        # observe(profile, now_ns, capture_to_offer_ms, step_ms) after each reconstructed contact; must not wait.
        self.observe: Callable[[str, int, float, float], None] | None = None
        self._tracker = ContactTracker()
        self.taken = self.processed = 0  # frames; they differ while one is in work
        self.stages = 0  # that have ended, of all frames
        self._mailbox = mailbox
        self._ledger = ledger
        self._timings = timings
        self._sink = sink

    def run(self) -> None:
        """Work until the mailbox is closed and empty."""
        while (frame := self._mailbox.take()) is not None:
            self.taken += 1
            result = self._timed(frame)
            self.processed += 1
            if (watch := self.watch) and result:
                watch(frame, result)

    def _timed(self, frame: Frame) -> Reconstruction | None:
        last_ns = time.monotonic_ns()
        ms = {"wait": (last_ns - frame.t_ns) / 1e6}

        def mark(stage: str) -> None:
            nonlocal last_ns
            now_ns = time.monotonic_ns()
            ms[stage] = (now_ns - last_ns) / 1e6
            last_ns = now_ns
            self.stages += 1

        reconstructor = self.reconstructor
        began_ns = last_ns
        result: Reconstruction | None
        if isinstance(reconstructor, Reason):
            result, calibration = _not_reconstructed(frame, reconstructor), None
        else:
            need = (Need.DEPTH if self.watch else Need.CONTACT) | self._sink.need()
            result, calibration = reconstructor.step(frame, mark, need), reconstructor.calibration
            if result and result.valid:
                result = follow(self._tracker, result)
        step_ms = (time.monotonic_ns() - began_ns) / 1e6
        outcome = self._sink.deliver(frame, result, calibration)
        mark("deliver")
        ms["capture_to_offer"] = (last_ns - frame.t_ns) / 1e6
        self._timings.add(ms)
        if outcome is not None:
            self._ledger.settle(frame.seq, outcome)
        if (observe := self.observe) and result and result.contact:
            observe(result.profile, last_ns, ms["capture_to_offer"], step_ms)
        return result


def _not_reconstructed(frame: Frame, reason: Reason) -> Reconstruction:
    """An invalid frame, whose disc nobody knows."""
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
        height=HeightMap(np.zeros((0, 0), np.float32), np.zeros((0, 0), np.bool_), 0.0, 0.0, 1.0),
        cloud=ObjectCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16)),
    )
