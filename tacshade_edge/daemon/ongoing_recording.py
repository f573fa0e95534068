"""A recording that goes on, what is reported of it, and how it may end."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tacshade_edge.reasons import Reason, ReasonCode, reason_fields
from tacshade_edge.recording.recorder import RecordingWriter
from tacshade_edge.types import Calibration

TIME, STOPPED = Reason(ReasonCode.TIME, "time"), Reason(ReasonCode.STOPPED, "stopped")
SOURCE_ENDED = Reason(ReasonCode.SOURCE_ENDED, "the frame source has no more frames")
DAEMON_STOPPED = Reason(ReasonCode.DAEMON_STOPPED, "the daemon stopped")
# These endings are normal and leave the recorder idle; any other is a reason that it stopped.
GOOD_ENDINGS = (
    ReasonCode.TIME,
    ReasonCode.STOPPED,
    ReasonCode.SOURCE_ENDED,
    ReasonCode.DAEMON_STOPPED,
)


@dataclass(frozen=True, slots=True)
class Recorded:
    """State of a recording, or its result: `dropped` frames were captured meanwhile but are not in
    it; `ending` is None while it runs, then one of `GOOD_ENDINGS`, or what went wrong.
    """

    folder: Path
    frames: int
    bytes: int
    dropped: int
    ending: Reason | None

    @property
    def failed(self) -> bool:
        return self.ending is not None and self.ending.code not in GOOD_ENDINGS

    def as_dict(self) -> dict[str, str | int | float]:
        """The content of ``status/recorder``, ``res/record`` and ``recording.json``."""
        counts = {"frames": self.frames, "bytes": self.bytes, "dropped": self.dropped}
        return {"folder": str(self.folder), **counts, **reason_fields(self.ending, "ending")}


@dataclass(slots=True, eq=False)
class OngoingRecording:
    """A recording that goes on; it is also the queue's item at which the thread begins it.

    Its first ending counts.
    """

    recorder: RecordingWriter
    settings_yaml: str
    calibration: Calibration
    about: Mapping[str, object]
    seconds: float
    began_ns: int = field(default_factory=time.monotonic_ns)
    ending: Reason | None = None
    done: bool = False
    refused: int = 0  # frames, by the queue
    lost: int = 0  # frames taken but not written
    first: tuple[int, int] | None = None

    @property
    def end_ns(self) -> int:
        return self.began_ns + round(self.seconds * 1e9)

    def now(self) -> Recorded:
        recorder = self.recorder
        return Recorded(
            recorder.folder, recorder.frames, recorder.bytes, self.refused + self.lost, self.ending
        )
