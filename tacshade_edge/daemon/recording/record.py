"""Recording beside the running daemon: one recording at a time, written by a thread of its own.

`Grab` hands each captured frame to `_Job.tap`; the bounded queue behind it keeps the disk from ever delaying a frame.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.daemon.pipeline.workers import Grab
from tacshade_edge.daemon.recording.byte_queue import ByteQueue
from tacshade_edge.devices.files.recorder import FREE_FLOOR_BYTES, Recorder
from tacshade_edge.errors import DeviceError
from tacshade_edge.reasons import Reason, ReasonCode, reason_fields
from tacshade_edge.types import Calibration, Frame

# 54 grey frames of 640x480: almost a second at 60 per second. Of the 150 MB that the service may use.
QUEUE_BYTES = 16 * 2**20
EVENT_BYTES, EVENTS_RESERVE_BYTES = 1024, 256 * 1024  # an event counts for a KiB, and fits where no frame does
SYNC_S = 1.0
Posed = Callable[[Frame], Frame]
TIME, STOPPED = Reason(ReasonCode.TIME, "time"), Reason(ReasonCode.STOPPED, "stopped")
SOURCE_ENDED = Reason(ReasonCode.SOURCE_ENDED, "source ended")
DAEMON_STOPPED = Reason(ReasonCode.DAEMON_STOPPED, "daemon stopped")
# As they should: these leave the recorder idle, anything else is a reason that it stopped.
GOOD_ENDINGS = (ReasonCode.TIME, ReasonCode.STOPPED, ReasonCode.SOURCE_ENDED, ReasonCode.DAEMON_STOPPED)


@dataclass(frozen=True, slots=True)
class RecordingEnded:
    """The thread of a recording is done: `LiveRecorder.poll` has its figures."""


@dataclass(frozen=True, slots=True)
class _Event:
    t_ns: int
    kind: str
    data: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Recorded:
    """How a recording is, or was.

    Attributes
    ----------
    folder : Path
    frames, bytes, dropped : int
        Written frames and their size, and frames that were captured meanwhile and are not in it.
    ending : Reason or None
        None while it goes on; one of `GOOD_ENDINGS`, or what went wrong.
    """

    folder: Path
    frames: int
    bytes: int
    dropped: int
    ending: Reason | None

    @property
    def failed(self) -> bool:
        """Whether something went wrong."""
        return self.ending is not None and self.ending.code not in GOOD_ENDINGS

    def as_dict(self) -> dict[str, str | int | float]:
        """For ``status/recorder``, ``res/record`` and ``recording.json``."""
        return {
            "folder": str(self.folder),
            "frames": self.frames,
            "bytes": self.bytes,
            "dropped": self.dropped,
            **reason_fields(self.ending, "ending"),
        }


class _Job:
    """One recording. Its first ending counts."""

    def __init__(
        self, recorder: Recorder, seconds: float, settings_yaml: str, calibration: Calibration, posed: Posed | None
    ) -> None:
        self._posed = posed
        self.calibration_crc32 = calibration.crc32
        self.end_ns = time.monotonic_ns() + round(seconds * 1e9)
        self.waiting: ByteQueue[Frame | _Event] = ByteQueue(QUEUE_BYTES)
        self.ending: Reason | None = None
        self.done = False
        self._recorder = recorder
        self._begin = settings_yaml, calibration
        self._lost = 0  # accepted, and not written
        self._first: tuple[int, int] | None = None

    def tap(self, frame: Frame) -> None:
        """See the next captured frame; called in the grab thread."""
        if frame.t_ns <= self.end_ns:
            self.waiting.put(frame, frame.image.nbytes)

    def end(self, ending: Reason) -> None:
        """Take nothing more; the thread writes what waits."""
        self.ending = self.ending or ending
        self.waiting.close()

    def now(self) -> Recorded:
        """The figures of this instant."""
        recorder = self._recorder
        dropped = self.waiting.refused + self._lost
        return Recorded(recorder.folder, recorder.frames, recorder.bytes, dropped, self.ending)

    def write(self, about: Mapping[str, object]) -> None:
        """The thread: write until the end."""
        try:
            self._recorder.begin(*self._begin)
            self._write_all()
        except DeviceError as error:
            self.end(error.reason)
        self._lost += sum(isinstance(self.waiting.take(0), Frame) for _ in range(len(self.waiting)))
        times = dict(zip(("first_t_ns", "first_wall_ns"), self._first or (None, None), strict=True))
        try:
            self._recorder.finish({**self.now().as_dict(), **times, **about})
        except DeviceError as error:
            if not self.now().failed:
                self.ending = error.reason
            self._recorder.close()
        self.done = True

    def _write_all(self) -> None:
        synced_s = time.monotonic()
        while not self.waiting.drained:
            item = self.waiting.take(SYNC_S)
            if isinstance(item, _Event):
                self._recorder.event(item.t_ns, item.kind, item.data)
            elif item is not None:
                self._add(item)
            if time.monotonic() - synced_s >= SYNC_S:
                self._recorder.sync()
                synced_s = time.monotonic()

    def _add(self, frame: Frame) -> None:
        if self._posed is not None:
            frame = self._posed(frame)
        try:
            if not self._recorder.add(frame):
                found = f"less than {FREE_FLOOR_BYTES // 2**20} MiB free on the disk"
                raise DeviceError(found, code=ReasonCode.DISK_FULL)
        except DeviceError:
            self._lost += 1
            raise
        self._first = self._first or (frame.t_ns, frame.wall_ns)


class LiveRecorder:
    """Starts and ends recordings; used by the main thread alone.

    Parameters
    ----------
    grab : Grab
        Its `tap` is set while a recording goes on.
    report : callable
        Gets a `RecordingEnded` in the recording's thread.
    posed : callable or None
        Gives a frame its pose; called in the recording's thread, which it may keep waiting for a moment.
    """

    def __init__(self, grab: Grab, report: Callable[[RecordingEnded], None], posed: Posed | None = None) -> None:
        self._posed = posed
        self._grab = grab
        self._report = report
        self._job: _Job | None = None
        self._thread: threading.Thread | None = None
        self._written = self._dropped = 0  # of recordings that ended

    def start(
        self, folder: Path, seconds: float, settings_yaml: str, calibration: Calibration, about: Mapping[str, object]
    ) -> None:
        """Begin a recording.

        Parameters
        ----------
        folder : Path
            A new one.
        seconds : float
        settings_yaml : str
        calibration : Calibration
            What a replay must use.
        about : mapping
            More for ``recording.json``.

        Raises
        ------
        ConfigError
            The folder is there already.
        DeviceError
            One goes on (``BUSY``); the folder cannot be made; the disk is down to the floor.
        """
        if (now := self.now()) is not None:
            doing = "the latest is still being written to" if now.ending else "recording to"
            raise DeviceError(f"busy: {doing} {now.folder}", code=ReasonCode.BUSY)
        recorder = Recorder(folder, free_floor_bytes=FREE_FLOOR_BYTES)
        job = _Job(recorder, seconds, settings_yaml, calibration, self._posed)

        def run() -> None:
            job.write(about)
            self._report(RecordingEnded())

        self._job, self._thread = job, threading.Thread(target=run, name="record", daemon=True)
        self._thread.start()
        self._grab.tap = job.tap

    def end(self, ending: Reason) -> None:
        """End the recording that goes on, if one does; `poll` tells when it is written."""
        self._grab.tap = None
        if self._job is not None:
            self._job.end(ending)

    def event(self, kind: str, **data: object) -> None:
        """Something happened that a person who looks at the recording must know."""
        if self._job is not None:
            event = _Event(time.monotonic_ns(), kind, data)
            self._job.waiting.put(event, EVENT_BYTES, reserve_bytes=EVENTS_RESERVE_BYTES)

    def reconstructs_with(self, profile: str, calibration_crc32: int) -> None:
        """The profile or the calibration may have changed: another reference ends a recording, which has the old."""
        if (job := self._job) is None:
            return
        self.event("reconstruction", profile=profile, calibration_crc32=calibration_crc32)
        if calibration_crc32 != job.calibration_crc32:
            text = "another reference or calibration came into use"
            self.end(Reason(ReasonCode.CALIBRATION_CHANGED, text))

    def poll(self) -> Recorded | None:
        """End what is over; the recording that was finished since the last call."""
        job = self._job
        if job is None:
            return None
        if not job.ending and time.monotonic_ns() > job.end_ns:
            self.end(TIME)
        if job.ending:
            self._grab.tap = None  # a disk that failed ends it from the other side
        if not job.done:
            return None
        recorded = job.now()
        self._written += recorded.frames
        self._dropped += recorded.dropped
        self._job = None
        return recorded

    def now(self) -> Recorded | None:
        """The recording that goes on or is being finished."""
        return self._job.now() if self._job else None

    def counts(self) -> dict[str, int]:
        """For ``health``: frames written, dropped and waiting, since the daemon's start."""
        now, waiting = self.now(), len(self._job.waiting) if self._job else 0
        written, dropped = (now.frames, now.dropped) if now else (0, 0)
        return {"written": self._written + written, "dropped": self._dropped + dropped, "waiting": waiting}

    def join(self, timeout_s: float) -> None:
        """Wait for the recording's thread."""
        if self._thread is not None:
            self._thread.join(timeout_s)
