"""Records next to the running daemon (``req/record``), one recording at a time, by a thread behind
a bounded queue: no frame waits for the disk. With a pre-roll, the thread keeps the latest frames,
and a recording begins with them.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Generic, Literal, TypeVar

import msgspec
import numpy as np

from tacshade_edge.calibration.files.calibration_file import packed
from tacshade_edge.errors import DeviceError, TacshadeError
from tacshade_edge.files.atomic_files import FREE_FLOOR_BYTES
from tacshade_edge.pipeline.observer import RECORDED_S, FrameObserver, Reply, SourceState
from tacshade_edge.reasons import Reason, ReasonCode, reason_fields
from tacshade_edge.recording.recorder import McapRecorder, RecordingWriter, png_of
from tacshade_edge.recording.recording_content import CALIBRATION_NAME, Event
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.settings import Settings, to_yaml
from tacshade_edge.types import Calibration, Frame
from tacshade_edge.version import installed_version
from tacshade_edge.wire.messages import encode_status
from tacshade_edge.wire.requests import Request

_log = logging.getLogger(__name__)
T = TypeVar("T")


class ByteQueue(Generic[T]):
    """A first-in, first-out queue between two threads, bounded in bytes."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._ready = threading.Condition()
        self._items: deque[tuple[T, int]] = deque()
        self._bytes = 0
        self._closed = False

    def put(self, item: T, size_bytes: int, *, reserve_bytes: int = 0) -> bool:
        """Add an item, or return False if full.

        `reserve_bytes` above the limit are for this kind of item.
        """
        with self._ready:
            if self._items and self._bytes + size_bytes > self._limit + reserve_bytes:
                return False
            self._items.append((item, size_bytes))
            self._bytes += size_bytes
            self._ready.notify()
            return True

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


# 54 grey frames of 640x480: almost a second at 60 per second.
# Part of the 150 MB that the service may use.
QUEUE_BYTES: Final = 16 * 2**20
EVENTS_RESERVE_BYTES: Final = 256 * 1024  # an event fits when no frame does
PRE_ROLL_BYTES: Final = 64 * 2**20
"""As PNG, 12 s of grey 640x480 at 30 frames/s, 4 s in colour.

Within the service's 150 MB, with 16 MiB that wait.
"""
EVENT_BYTES: Final = 1024
SYNC_S = STATUS_PERIOD_S = 1.0
_NO_PIXELS = np.zeros((0, 0), np.uint8)
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
class Shot:
    """A captured frame with its pose but without pixels, and its image as PNG."""

    frame: Frame
    png: bytes

    @property
    def t_ns(self) -> int:
        return self.frame.t_ns


Kept = Shot | Event | Literal["end"]


def _size(item: Kept) -> int:
    return len(item.png) if isinstance(item, Shot) else EVENT_BYTES


def _frames(items: Iterable[object]) -> int:
    return sum(isinstance(item, Shot | Frame) for item in items)


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
class _Recording:
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


class LiveRecorder(FrameObserver):
    """Carries out ``req/record``, each request with one reply, for ``stop`` when everything is
    written. `written` and `posed`, which may wait for a frame's pose, are called in the thread
    `record`.
    """

    health_key = "recorder"
    stop_s = RECORDED_S

    def __init__(
        self,
        publish: Callable[[bytes], None],
        written: Callable[[], None],
        posed: Callable[[Frame], Frame] = lambda frame: frame,
        pre_roll_s: float = 0.0,
    ) -> None:
        self._publish = publish
        self._written = written
        self._posed = posed
        self._queue: ByteQueue[Frame | Event | _Recording | Literal["end"]] = ByteQueue(QUEUE_BYTES)
        self._kept: deque[Kept] = deque()  # to be written, or perhaps; the record thread's
        self._recording: _Recording | None = None
        self._latest: Recorded | None = None
        self._stop_reply: Reply | None = None
        self._counts = {"written": 0, "dropped": 0}  # of recordings that ended
        self._pre_roll_ns = round(pre_roll_s * 1e9)
        self._oldest_ns = 0  # older frames are of another calibration
        self._pre_roll = self._refused = self._given_up = (
            0  # frames: kept, refused by the queue, without room
        )
        self._calibration_crc32: int | None = None
        self._published, self._published_s = b"", 0.0
        self._published_folder: Path | None = None
        self._thread = threading.Thread(target=self._run, name="record", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout_s: float) -> None:
        """Wait until the recording is written, and answer a ``stop`` request."""
        self.end(DAEMON_STOPPED)
        self._queue.close()
        self._thread.join(timeout_s)
        self.poll()

    def handle(
        self,
        request: Request,
        reply: Reply,
        settings: Settings,
        reconstructor: Reconstructor,
        source: SourceState,
    ) -> None:
        try:
            if request.action == "start":
                reply({"folder": str(self._start(request, settings, reconstructor, source))})
            elif (recording := self._recording) is None:
                raise DeviceError(
                    f"found no recording to {request.action}", code=ReasonCode.NO_RECORDING
                )
            elif request.action == "mark":
                self.event("mark", text=request.text)
                reply(
                    {"folder": str(recording.recorder.folder), "frames": recording.recorder.frames}
                )
            elif self._stop_reply is not None:
                raise DeviceError("busy: the recording is already stopping", code=ReasonCode.BUSY)
            else:
                self._stop_reply = reply
                self.end(STOPPED)
        except TacshadeError as error:
            reply(error.reason)
        self.poll()

    def _start(
        self,
        request: Request,
        settings: Settings,
        reconstructor: Reconstructor,
        source: SourceState,
    ) -> Path:
        name = request.name or time.strftime("%Y%m%d-%H%M%S", time.gmtime())
        folder = Path(settings.recorder.folder) / name
        calibration, profile = reconstructor.calibration, reconstructor.profile.name
        about = {
            "version": installed_version(),
            "profile": profile,
            "calibration_crc32": calibration.crc32,
        }
        make = (
            RecordingWriter
            if request.format == "folder"
            else partial(McapRecorder, sensor_id=settings.sensor_id)
        )
        replayable = to_yaml(msgspec.structs.replace(settings, calibration=CALIBRATION_NAME))
        try:
            self.begin(folder, request.seconds, replayable, calibration, about, make)
        except DeviceError as error:
            if error.code != ReasonCode.DISK:
                raise
            fix = "set recorder.folder to a folder that the daemon can write to"
            raise DeviceError(f"{error}; {fix}", code=error.code) from None
        state = {"state": source.state, **reason_fields(source.reason)}
        self.event("start", wall_ns=time.time_ns(), **state, source=source.details, **about)
        _log.info("recording to %s", folder)
        return folder

    def begin(
        self,
        folder: Path,
        seconds: float,
        settings_yaml: str,
        calibration: Calibration,
        about: Mapping[str, object],
        make: Callable[..., RecordingWriter] = RecordingWriter,
    ) -> None:
        """Begin a recording in a new folder; `about` goes to ``recording.json``.

        Raises TacshadeError.
        """
        if (now := self.now()) is not None:
            doing = (
                "still writing the latest recording to" if now.ending else "already recording to"
            )
            raise DeviceError(f"busy: {doing} {now.folder}", code=ReasonCode.BUSY)
        recorder = make(folder)
        recording = _Recording(recorder, settings_yaml, calibration, about, seconds)
        self._queue.put(recording, 0, reserve_bytes=EVENTS_RESERVE_BYTES)
        self._recording = recording

    def end(self, ending: Reason) -> None:
        """End the present recording, if there is one; `poll` publishes when it is written."""
        if (recording := self._recording) is not None and recording.ending is None:
            recording.ending = ending
            self._queue.put("end", 0, reserve_bytes=EVENTS_RESERVE_BYTES)

    @property
    def tap(self) -> Callable[[Frame], None] | None:
        """The function that takes each captured frame,
        while a recording runs or a pre-roll is kept.
        """
        recording = self._recording
        return self._take if self._pre_roll_ns or (recording and not recording.ending) else None

    def _take(self, frame: Frame) -> None:
        recording = self._recording
        if recording is not None and frame.t_ns > recording.end_ns:
            return
        if self._queue.put(frame, frame.image.nbytes):
            return
        if recording is not None and recording.ending is None:
            recording.refused += 1
        else:
            self._refused += 1

    def event(self, kind: str, **data: object) -> None:
        if self._recording is not None or self._pre_roll_ns:
            event = Event(time.monotonic_ns(), kind, data)
            self._queue.put(event, EVENT_BYTES, reserve_bytes=EVENTS_RESERVE_BYTES)

    def settings_changed(self, settings: Settings) -> None:
        self._pre_roll_ns = round(settings.recorder.pre_roll_s * 1e9)

    def source_changed(self, source: SourceState) -> None:
        self.event("source", state=source.state, **reason_fields(source.reason))

    def reconstructs_with(self, profile: str, calibration_crc32: int) -> None:
        """Note the profile and calibration in use: another reference ends a recording,
        which contains the old one.
        """
        self.event("reconstruction", profile=profile, calibration_crc32=calibration_crc32)
        if calibration_crc32 != self._calibration_crc32:
            self._calibration_crc32, self._oldest_ns = calibration_crc32, time.monotonic_ns()
        if self._recording is not None and calibration_crc32 != self._recording.calibration.crc32:
            self.end(Reason(ReasonCode.CALIBRATION_CHANGED, "the reference or calibration changed"))

    def now(self) -> Recorded | None:
        return self._recording.now() if self._recording else None

    def health(self) -> dict[str, int]:
        """Frames written and dropped since the start, frames waiting, and the pre-roll."""
        recording, now = self._recording, self.now()
        counts = {
            "written": self._counts["written"] + (now.frames if now else 0),
            "dropped": self._counts["dropped"] + (now.dropped if now else 0),
            "waiting": len(self._queue) + len(self._kept) if recording else 0,
        }
        if self._pre_roll_ns:
            counts["pre_roll"] = 0 if recording else self._pre_roll
            counts["pre_roll_dropped"] = self._refused + self._given_up
        return counts

    def poll(self) -> None:
        """End a recording that is over, answer the request to stop it,
        and publish ``status/recorder``.
        """
        recording = self._recording
        if recording is not None and time.monotonic_ns() > recording.end_ns:
            self.end(TIME)
        if recording is not None and recording.done:
            self._latest, self._recording = recording.now(), None
            self._counts["written"] += self._latest.frames
            self._counts["dropped"] += self._latest.dropped
            _log.info("recording ended: %s", self._latest.as_dict())
            if (reply := self._stop_reply) is not None:
                self._stop_reply = None
                reply(self._latest.as_dict())
        self._publish_status(time.monotonic())

    def _publish_status(self, now_s: float) -> None:
        recording, latest = self._recording, self._latest
        folder = recording.recorder.folder if recording else None
        if recording is not None:
            seconds = {"seconds": round((time.monotonic_ns() - recording.began_ns) / 1e9, 1)}
            details: dict[str, Any] = {
                **recording.now().as_dict(),
                **seconds,
                "of_seconds": recording.seconds,
            }
            status = encode_status("recording", None, details)
        elif latest is None:
            status = encode_status("idle")
        else:
            state, reason = ("stopped", latest.ending) if latest.failed else ("idle", None)
            status = encode_status(state, reason, latest.as_dict())
        going_on = recording is not None and self._published_folder == folder
        if status == self._published or (going_on and now_s < self._published_s + STATUS_PERIOD_S):
            return
        self._published, self._published_s, self._published_folder = status, now_s, folder
        self._publish(status)

    # The thread runs these.

    def _run(self) -> None:
        """Take one in and write one out, so that what is kept never grows,
        and is written while nothing comes.
        """
        kept, recording, synced_s = self._kept, None, 0.0
        while True:
            writing = recording is not None and bool(kept)
            item = self._queue.take(0 if writing else SYNC_S)
            if item is None and not writing and self._queue.drained:
                return
            now_ns = time.monotonic_ns()
            try:
                if isinstance(item, _Recording):
                    recording = item
                    item.recorder.begin(item.settings_yaml, packed(item.calibration))
                elif isinstance(item, Frame):
                    frame = self._posed(item)
                    kept.append(Shot(replace(frame, image=_NO_PIXELS), png_of(frame.image)))
                    now_ns = item.t_ns
                elif item is not None and (recording is not None or isinstance(item, Event)):
                    kept.append(item)
                if recording is None:
                    self._bound(now_ns - self._pre_roll_ns)
                elif kept and self._write(recording):
                    recording = None
                elif time.monotonic() - synced_s >= SYNC_S:
                    recording.recorder.sync()
                    synced_s = time.monotonic()
            except DeviceError as error:
                assert recording is not None
                self._fail(recording, error.reason)
                recording = None

    def _bound(self, oldest_ns: int) -> None:
        """Keep only the pre-roll; without one, nothing."""
        kept, oldest_ns = (
            self._kept,
            max(oldest_ns, self._oldest_ns) if self._pre_roll_ns else 2**63,
        )
        while kept and (isinstance(kept[0], str) or kept[0].t_ns < oldest_ns):
            kept.popleft()
        too_many_bytes = sum(map(_size, kept)) - PRE_ROLL_BYTES
        while too_many_bytes > 0:
            item = kept.popleft()
            too_many_bytes -= _size(item)
            self._given_up += isinstance(item, Shot)
        self._pre_roll = _frames(kept)

    def _write(self, recording: _Recording) -> bool:
        """Write the oldest of what is kept; return whether it was the end."""
        item, recorder = self._kept[0], recording.recorder
        if isinstance(item, str):
            self._finish(recording)
        elif isinstance(item, Event):
            recorder.event(item.t_ns, item.kind, item.data)
        elif not recorder.add(item.frame, item.png):
            found = f"less than {FREE_FLOOR_BYTES // 2**20} MiB free on the disk"
            raise DeviceError(found, code=ReasonCode.DISK_FULL)
        else:
            recording.first = recording.first or (item.frame.t_ns, item.frame.wall_ns)
        self._kept.popleft()
        return isinstance(item, str)

    def _fail(self, recording: _Recording, reason: Reason) -> None:
        """End a recording that cannot be written further; what waits for it is lost."""
        recording.ending = recording.ending or reason
        waiting = [self._queue.take(0) for _ in range(len(self._queue))]
        recording.lost += _frames((*waiting, *self._kept))
        self._kept.clear()
        self._finish(recording)

    def _finish(self, recording: _Recording) -> None:
        now = recording.now()
        times = dict(
            zip(("first_t_ns", "first_wall_ns"), recording.first or (None, None), strict=True)
        )
        try:
            recording.recorder.finish({**now.as_dict(), **times, **recording.about})
        except DeviceError as error:
            if not now.failed:
                recording.ending = error.reason
            recording.recorder.close()
        recording.done = True
        self._written()
