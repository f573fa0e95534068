"""Recording next to the running daemon, one at a time, by a thread behind a bounded queue: no frame waits for the disk.

If recordings begin with a pre-roll, the thread runs before the request and keeps the frames that it will write first.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final, Generic, TypeVar

import numpy as np

from tacshade_edge.errors import DeviceError
from tacshade_edge.reasons import Reason, ReasonCode, reason_fields
from tacshade_edge.storage.atomic_files import FREE_FLOOR_BYTES
from tacshade_edge.storage.recording.recorder import Recorder, png_of
from tacshade_edge.types import Calibration, Frame

T = TypeVar("T")


class ByteQueue(Generic[T]):
    """A first-in, first-out queue between two threads, bounded in bytes; `refused` counts what found it full."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._ready = threading.Condition()
        self._items: deque[tuple[T, int]] = deque()
        self._bytes = 0
        self._closed = False
        self.refused = 0

    def put(self, item: T, size_bytes: int, *, reserve_bytes: int = 0) -> None:
        """Add an item; refuse and count it if full. `reserve_bytes` above the limit are for this kind of item."""
        with self._ready:
            if self._closed:
                return
            if self._items and self._bytes + size_bytes > self._limit + reserve_bytes:
                self.refused += 1
                return
            self._items.append((item, size_bytes))
            self._bytes += size_bytes
            self._ready.notify()

    def take(self, timeout_s: float) -> T | None:
        with self._ready:
            self._ready.wait_for(lambda: self._items or self._closed, timeout_s)
            if not self._items:
                return None
            item, size_bytes = self._items.popleft()
            self._bytes -= size_bytes
            return item

    def close(self) -> None:
        with self._ready:
            self._closed = True
            self._ready.notify_all()

    @property
    def drained(self) -> bool:
        with self._ready:
            return self._closed and not self._items

    def __len__(self) -> int:
        return len(self._items)


PRE_ROLL_BYTES: Final = 64 * 2**20
"""As PNG, 12 s of grey 640x480 at 30 frames/s, 4 s in colour. Within the service's 150 MB, with 16 MiB that wait."""
EVENT_BYTES: Final = 1024


@dataclass(frozen=True, slots=True)
class Shot:
    """A captured frame with its pose but without pixels, and its image as PNG."""

    frame: Frame
    png: bytes

    @property
    def t_ns(self) -> int:
        return self.frame.t_ns


@dataclass(frozen=True, slots=True)
class Event:
    """Something that a person who looks at the recording must know."""

    t_ns: int
    kind: str
    data: Mapping[str, object]


class Kept:
    """The latest frames, encoded, for one thread; `given_up` counts those that `bound` removed for lack of room."""

    def __init__(self) -> None:
        self._items: deque[Shot | Event] = deque()
        self._bytes = 0
        self.frames = self.given_up = 0

    def add(self, item: Shot | Event) -> None:
        self._items.append(item)
        self._bytes += _size(item)
        self.frames += isinstance(item, Shot)

    def take(self) -> Shot | Event:
        item = self._items.popleft()
        self._bytes -= _size(item)
        self.frames -= isinstance(item, Shot)
        return item

    def forget(self, oldest_ns: int) -> None:
        while self._items and self._items[0].t_ns < oldest_ns:
            self.take()

    def bound(self, limit_bytes: int) -> None:
        """Remove the oldest items until the rest has at most this many bytes."""
        while self._bytes > limit_bytes:
            self.given_up += isinstance(self.take(), Shot)

    def __len__(self) -> int:
        return len(self._items)


def _size(item: Shot | Event) -> int:
    return len(item.png) if isinstance(item, Shot) else EVENT_BYTES


# 54 grey frames of 640x480: almost a second at 60 per second. Part of the 150 MB that the service may use.
QUEUE_BYTES = 16 * 2**20
EVENTS_RESERVE_BYTES = 256 * 1024  # an event fits when no frame does
SYNC_S = 1.0
_NO_PIXELS = np.zeros((0, 0), np.uint8)
Posed = Callable[[Frame], Frame]
TIME, STOPPED = Reason(ReasonCode.TIME, "time"), Reason(ReasonCode.STOPPED, "stopped")
SOURCE_ENDED = Reason(ReasonCode.SOURCE_ENDED, "the frame source has no more frames")
DAEMON_STOPPED = Reason(ReasonCode.DAEMON_STOPPED, "the daemon stopped")
# These endings are normal and leave the recorder idle; any other is a reason that it stopped.
GOOD_ENDINGS = (ReasonCode.TIME, ReasonCode.STOPPED, ReasonCode.SOURCE_ENDED, ReasonCode.DAEMON_STOPPED)


@dataclass(frozen=True, slots=True)
class Recorded:
    """State of a recording, or its result: `dropped` frames were captured meanwhile but are not in it; `ending` is None
    while it runs, then one of `GOOD_ENDINGS`, or what went wrong.
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
        return {
            "folder": str(self.folder),
            "frames": self.frames,
            "bytes": self.bytes,
            "dropped": self.dropped,
            **reason_fields(self.ending, "ending"),
        }


class _Job:
    """One recording, or the frames kept before one is requested. Its first ending counts."""

    def __init__(self, pre_roll_ns: int, posed: Posed | None) -> None:
        self.recorder: Recorder | None = None  # once a recording is requested
        self.calibration_crc32 = 0
        self.end_ns = 0
        self.waiting: ByteQueue[Frame | Event] = ByteQueue(QUEUE_BYTES)
        self.kept = Kept()
        self.ending: Reason | None = None
        self.done = False
        self._about: Mapping[str, object] = {}
        self._refused = 0  # before the request
        self._pre_roll_ns = pre_roll_ns
        self._oldest_ns = 0
        self._posed = posed
        self._lost = 0  # accepted but not written
        self._first: tuple[int, int] | None = None

    def start(
        self, recorder: Recorder, begin: Callable[[], None], seconds: float, crc32: int, about: Mapping[str, object]
    ) -> None:
        """Write what is kept, and what comes."""
        now_ns = time.monotonic_ns()
        self.end_ns = now_ns + round(seconds * 1e9)
        self._oldest_ns = max(now_ns - self._pre_roll_ns, self._oldest_ns) if self._pre_roll_ns else 0
        self._refused, self._begin, self.calibration_crc32, self._about = self.waiting.refused, begin, crc32, about
        self.recorder = recorder  # last: the thread begins to write

    def tap(self, frame: Frame) -> None:
        """Take the next captured frame; called in the grab thread."""
        if self.recorder is None or frame.t_ns <= self.end_ns:
            self.waiting.put(frame, frame.image.nbytes)

    def forget(self) -> None:
        self._oldest_ns = time.monotonic_ns()

    def end(self, ending: Reason) -> None:
        """Accept nothing more; the thread writes what waits."""
        self.ending = self.ending or ending
        self.waiting.close()

    def now(self) -> Recorded | None:
        if (recorder := self.recorder) is None:
            return None
        dropped = self.waiting.refused - self._refused + self._lost
        return Recorded(recorder.folder, recorder.frames, recorder.bytes, dropped, self.ending)

    def pre_roll_dropped(self) -> int:
        """Number of frames recent enough to be kept that were not, until the recording was requested."""
        return self.kept.given_up + (self._refused if self.recorder else self.waiting.refused)

    def work(self) -> bool:
        """Run the thread: keep frames until a recording is requested, then write to its end; return whether one was."""
        while self.recorder is None and not self.waiting.drained:
            if (item := self._take(SYNC_S)) is not None:
                self.kept.add(item)
                self.kept.forget(max(item.t_ns - self._pre_roll_ns, self._oldest_ns))
                self.kept.bound(PRE_ROLL_BYTES)
        if self.recorder is not None:
            self._write(self.recorder)
        return self.recorder is not None

    def _take(self, timeout_s: float) -> Shot | Event | None:
        item = self.waiting.take(timeout_s)
        if not isinstance(item, Frame):
            return item
        frame = item if self._posed is None else self._posed(item)
        return Shot(replace(frame, image=_NO_PIXELS), png_of(frame.image))

    def _write(self, recorder: Recorder) -> None:
        self.kept.forget(self._oldest_ns)
        try:
            self._begin()
            self._write_all(recorder)
        except DeviceError as error:
            self.end(error.reason)
        self._lost += sum(isinstance(self.waiting.take(0), Frame) for _ in range(len(self.waiting)))
        self._lost += sum(isinstance(self.kept.take(), Shot) for _ in range(len(self.kept)))
        times = dict(zip(("first_t_ns", "first_wall_ns"), self._first or (None, None), strict=True))
        now = self.now()
        assert now is not None
        try:
            recorder.finish({**now.as_dict(), **times, **self._about})
        except DeviceError as error:
            if not now.failed:
                self.ending = error.reason
            recorder.close()
        self.done = True

    def _write_all(self, recorder: Recorder) -> None:
        """Take one in and write one out, so that what is kept never grows, and is written while nothing comes."""
        synced_s = time.monotonic()
        while self.kept or not self.waiting.drained:
            if (item := self._take(0 if self.kept else SYNC_S)) is not None:
                self.kept.add(item)
            if self.kept:
                self._add(recorder, self.kept.take())
            if time.monotonic() - synced_s >= SYNC_S:
                recorder.sync()
                synced_s = time.monotonic()

    def _add(self, recorder: Recorder, item: Shot | Event) -> None:
        if isinstance(item, Event):
            recorder.event(item.t_ns, item.kind, item.data)
            return
        try:
            if not recorder.add(item.frame, item.png):
                found = f"less than {FREE_FLOOR_BYTES // 2**20} MiB free on the disk"
                raise DeviceError(found, code=ReasonCode.DISK_FULL)
        except DeviceError:
            self._lost += 1
            raise
        self._first = self._first or (item.frame.t_ns, item.frame.wall_ns)


class LiveRecorder:
    """Carries out ``req/record``, each request with one reply, for ``stop`` when everything is written. `written` and
    `posed`, which may wait for a frame's pose, are called in the thread `record`.
    """

    def __init__(self, report: Callable[[], None], posed: Posed | None = None) -> None:
        self.tap: Callable[[Frame], None] | None = None
        self._posed = posed
        self._report = report
        self._job: _Job | None = None
        self._thread: threading.Thread | None = None
        self._written = self._dropped = self._pre_roll_dropped = 0  # of recordings that ended
        self._pre_roll_ns = 0
        self._calibration_crc32: int | None = None

    def keep_pre_roll(self, pre_roll_s: float) -> None:
        """Make recordings begin this long before their request, from the next one on; 0: at the request."""
        pre_roll_ns = round(pre_roll_s * 1e9)
        if pre_roll_ns != self._pre_roll_ns and self._job is not None and self._job.recorder is None:
            self.tap = None
            self._close(self._job)
        self._pre_roll_ns = pre_roll_ns

    def start(
        self,
        folder: Path,
        seconds: float,
        settings_yaml: str,
        calibration: Calibration,
        about: Mapping[str, object],
        make: Callable[..., Recorder] = Recorder,
    ) -> None:
        """Begin a recording in a new folder; `about` goes to ``recording.json``. Raises TacshadeError."""
        if (now := self.now()) is not None:
            doing = "still writing the latest recording to" if now.ending else "already recording to"
            raise DeviceError(f"busy: {doing} {now.folder}", code=ReasonCode.BUSY)
        recorder = make(folder)
        job = self._job or _Job(0, self._posed)
        begin = partial(recorder.begin, settings_yaml, calibration)
        job.start(recorder, begin, seconds, calibration.crc32, about)
        if job is not self._job:
            self._run(job)

    def _run(self, job: _Job) -> None:
        def run() -> None:
            if job.work():
                self._report()

        self._job, self._thread = job, threading.Thread(target=run, name="record", daemon=True)
        self._thread.start()
        self.tap = job.tap

    def _close(self, job: _Job) -> None:
        """Add up the figures of a job that has ended, or that must keep nothing more."""
        job.waiting.close()
        self._pre_roll_dropped += job.pre_roll_dropped()
        self._job = None

    def end(self, ending: Reason) -> None:
        """End the present recording, if there is one; `poll` reports when it is written."""
        self.tap = None
        if ending is DAEMON_STOPPED:
            self._pre_roll_ns = 0  # `poll` starts no thread again
        if self._job is not None:
            self._job.end(ending)

    def event(self, kind: str, **data: object) -> None:
        if self._job is not None:
            event = Event(time.monotonic_ns(), kind, data)
            self._job.waiting.put(event, EVENT_BYTES, reserve_bytes=EVENTS_RESERVE_BYTES)

    def reconstructs_with(self, profile: str, calibration_crc32: int) -> None:
        """Note the profile and calibration in use: another reference ends a recording, which contains the old one."""
        other, self._calibration_crc32 = calibration_crc32 != self._calibration_crc32, calibration_crc32
        if (job := self._job) is None:
            return
        self.event("reconstruction", profile=profile, calibration_crc32=calibration_crc32)
        if job.recorder is None and other:
            job.forget()
        elif job.recorder and calibration_crc32 != job.calibration_crc32:
            self.end(Reason(ReasonCode.CALIBRATION_CHANGED, "the reference or calibration changed"))

    def poll(self) -> Recorded | None:
        """End a recording that is over; return one that was finished since the last call."""
        if self._job is None and self._pre_roll_ns:
            self._run(_Job(self._pre_roll_ns, self._posed))
        job = self._job
        if job is None or job.recorder is None:
            return None
        if not job.ending and time.monotonic_ns() > job.end_ns:
            self.end(TIME)
        if job.ending:
            self.tap = None  # a disk that failed ends it from the other thread
        if not job.done:
            return None
        recorded = job.now()
        assert recorded is not None
        self._written += recorded.frames
        self._dropped += recorded.dropped
        self._close(job)
        return recorded

    def now(self) -> Recorded | None:
        return self._job.now() if self._job else None

    def counts(self) -> dict[str, int]:
        """Counts for ``health``: frames written and dropped since the start, frames waiting, and the pre-roll."""
        job, now = self._job, self.now()
        waiting = len(job.waiting) + len(job.kept) if job and now else 0
        written, dropped = (now.frames, now.dropped) if now else (0, 0)
        counts = {"written": self._written + written, "dropped": self._dropped + dropped, "waiting": waiting}
        if not self._pre_roll_ns:
            return counts
        kept, given_up = (0 if now or not job else job.kept.frames), job.pre_roll_dropped() if job else 0
        return {**counts, "pre_roll": kept, "pre_roll_dropped": self._pre_roll_dropped + given_up}

    def join(self, timeout_s: float) -> None:
        if self._thread is not None:
            self._thread.join(timeout_s)
