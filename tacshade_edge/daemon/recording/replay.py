"""Replays a recording through the daemon's reconstructor and publisher, by the recording's clock.

One thread and no mailbox: every frame is reconstructed, in order, so equal input and settings give equal results.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from tacshade_edge.core.contact.tracking import ContactTracker
from tacshade_edge.core.reconstruct import Reconstructor, step_and_track
from tacshade_edge.daemon.pipeline.ledger import StageTimer, Timings
from tacshade_edge.daemon.recording.playback import Playback
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.storage.recording.recording import RecordedFrame, Recording
from tacshade_edge.types import Calibration, Reconstruction

Deliver = Callable[[RecordedFrame, Reconstruction], None]


@dataclass(slots=True)
class Progress:
    """The progress of a replay; it stays readable after an interruption.

    Attributes
    ----------
    frames, contacts, invalid, undecodable : int
        Undecodable images are not among the frames.
    first_ns, last_ns : int
        Time stamps of the recording.
    seconds : float
        Duration by our clock, including the waits of a paced replay.
    timings : Timings
    """

    frames: int = 0
    contacts: int = 0
    invalid: int = 0
    undecodable: int = 0
    first_ns: int = 0
    last_ns: int = 0
    seconds: float = 0.0
    timings: Timings = field(default_factory=Timings)

    @property
    def recorded_seconds(self) -> float:
        """Duration by the recording's clock, s, including the last frame's mean period."""
        if self.frames < 2:
            return 0.0
        return (self.last_ns - self.first_ns) / 1e9 * self.frames / (self.frames - 1)

    @property
    def speed_up(self) -> float:
        """Recorded time divided by our time."""
        return self.recorded_seconds / self.seconds if self.seconds > 0 else 0.0

    def as_dict(self) -> dict[str, Any]:
        """The content of ``timings.json``."""
        return {
            "frames": self.frames,
            "seconds": round(self.seconds, 4),
            "recorded_seconds": round(self.recorded_seconds, 4),
            "speed_up": round(self.speed_up, 3),
            "stages_ms": self.timings.percentiles(),
        }


def replay(
    recording: Recording | Playback,
    reconstructor: Reconstructor,
    sinks: Sequence[Deliver],
    progress: Progress,
    *,
    speed: float | None,
    undecodable: Callable[[str], None],
) -> None:
    """Reconstruct every frame and deliver it to every sink, in order.

    Parameters
    ----------
    recording : Recording or Playback
    reconstructor : Reconstructor
    sinks : sequence of callables
    progress : Progress
        Updated after each frame.
    speed : float or None
        Recorded seconds per second; None means as fast as possible.
    undecodable : callable
        Receives a line about every image that cannot be used.

    Raises
    ------
    ConfigError
        The first image does not have the calibration's size: it is another sensor's recording.
    """
    begin_ns = time.monotonic_ns()
    pause, tracker, timer = threading.Event(), ContactTracker(), StageTimer()
    while True:
        try:
            recorded = recording.read()
        except DecodeError as error:
            progress.undecodable += 1
            undecodable(str(error))
            continue
        if recorded is None:
            return
        frame = recorded.frame
        if progress.frames == 0:
            progress.first_ns = frame.t_ns
        if speed is not None:
            due_ns = begin_ns + (frame.t_ns - progress.first_ns) / speed
            pause.wait(max(0.0, (due_ns - time.monotonic_ns()) / 1e9))
        timer.begin()
        result = step_and_track(reconstructor, tracker, frame, timer.mark)
        assert result is not None  # by default everything is needed
        if progress.frames == 0 and result.reason is not None and result.reason.code is ReasonCode.SIZE:
            _refuse_size(recorded, reconstructor.calibration)
        for deliver in sinks:
            deliver(recorded, result)
        timer.mark("deliver")
        progress.timings.add(timer.ms)
        progress.frames += 1
        progress.contacts += result.contact
        progress.invalid += not result.valid
        progress.last_ns = frame.t_ns
        progress.seconds = (time.monotonic_ns() - begin_ns) / 1e9


def _refuse_size(recorded: RecordedFrame, calibration: Calibration) -> None:
    height, width = recorded.frame.image.shape[:2]
    raise ConfigError(
        f"{recorded.name}: found {width}x{height} px, expected {calibration.image_width_px}x"
        f"{calibration.image_height_px} px, the size of the calibration's images"
    )
