"""Records next to the running daemon (``req/record``), one recording at a time, by a thread behind
a bounded queue: no frame waits for the disk. With a pre-roll, the thread keeps the latest frames,
and a recording begins with them.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import msgspec

from tacshade_edge.daemon.ongoing_recording import (
    DAEMON_STOPPED,
    STOPPED,
    TIME,
    OngoingRecording,
    Recorded,
)
from tacshade_edge.daemon.pre_roll import EVENT_BYTES
from tacshade_edge.daemon.record_thread import RecordThread
from tacshade_edge.errors import DeviceError, TacshadeError
from tacshade_edge.files.atomic_files import free_name
from tacshade_edge.pipeline.observer import (
    RECORDED_S,
    STOPPING,
    FrameObserver,
    Reply,
    SourceState,
)
from tacshade_edge.reasons import Reason, ReasonCode, reason_fields
from tacshade_edge.recording.recorder import RecordingWriter
from tacshade_edge.recording.recording_content import CALIBRATION_NAME, Event
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.settings import Settings, to_yaml
from tacshade_edge.types import Calibration, Frame
from tacshade_edge.version import installed_version
from tacshade_edge.wire.messages import encode_status
from tacshade_edge.wire.requests import Request

_log = logging.getLogger(__name__)
# An event fits when no frame does: what happened explains why frames are missing.
EVENTS_RESERVE_BYTES: Final = 256 * 1024
# A status changes with every frame while a recording goes on.
STATUS_PERIOD_S: Final = 1.0
# Far above what a clock is slewed by between two looks.
_JUMP_NS: Final = 100_000_000


def _wall_minus_t_ns() -> int:
    return time.time_ns() - time.monotonic_ns()


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
        self._pre_roll_ns = round(pre_roll_s * 1e9)
        self._thread = RecordThread(written, posed, self._pre_roll_ns)
        # Beside the thread's own: `grab` reads the length and puts into the queue at each frame.
        self._queue = self._thread.queue
        self._recording: OngoingRecording | None = None
        self._latest: Recorded | None = None
        self._stop_reply: Reply | None = None
        self._counts = {"written": 0, "dropped": 0}  # of recordings that ended
        self._refused = 0  # frames of the pre-roll, by the queue
        self._calibration_crc32: int | None = None
        self._published, self._published_s = b"", 0.0
        self._published_folder: Path | None = None
        self._wall_minus_t_ns = _wall_minus_t_ns()

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout_s: float) -> None:
        """Wait until the recording is written, and answer a ``stop`` request."""
        self.end(DAEMON_STOPPED)
        self._thread.stop(timeout_s)
        self.poll()
        # A disk that hangs: it stays as it is, readable up to the last frame that was reported.
        if (reply := self._stop_reply) is not None:
            self._stop_reply = None
            reply(STOPPING)

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
        folder = Path(settings.recorder.folder)
        folder = folder / request.name if request.name else free_name(folder)
        calibration, profile = reconstructor.calibration, reconstructor.profile.name
        about = {
            "version": installed_version(),
            "profile": profile,
            "calibration_crc32": calibration.crc32,
        }
        replayable = to_yaml(msgspec.structs.replace(settings, calibration=CALIBRATION_NAME))
        try:
            self.begin(folder, request.seconds, replayable, calibration, about)
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
    ) -> None:
        """Begin a recording in a new folder; `about` goes to ``recording.json``.

        Raises TacshadeError.
        """
        if (now := self.now()) is not None:
            doing = (
                "still writing the latest recording to" if now.ending else "already recording to"
            )
            raise DeviceError(f"busy: {doing} {now.folder}", code=ReasonCode.BUSY)
        recorder = RecordingWriter(folder)
        recording = OngoingRecording(recorder, settings_yaml, calibration, about, seconds)
        # First the queue: `grab` puts frames as soon as it sees the recording, and what the thread
        # takes before the recording itself is dropped without a count.
        self._queue.put(recording, 0)
        self._recording = recording

    def end(self, ending: Reason) -> None:
        """End the present recording, if there is one; `poll` publishes when it is written."""
        if (recording := self._recording) is not None and recording.ending is None:
            recording.ending = ending
            self._queue.put("end", 0)

    @property
    def tap(self) -> Callable[[Frame], None] | None:
        """The function that takes each captured frame,
        while a recording runs or a pre-roll is kept.
        """
        recording = self._recording
        return self._take if self._pre_roll_ns or (recording and not recording.ending) else None

    def _take(self, frame: Frame) -> None:
        # In `grab`. The main thread may end the recording in between, so it is read once.
        recording = self._recording
        if recording is not None and frame.t_ns > recording.end_ns:
            return
        if self._queue.put(frame, frame.image.nbytes):
            return
        if recording is not None and recording.ending is None:
            # Only this thread counts here; what the other one loses has a number of its own.
            recording.refused += 1
        else:
            self._refused += 1

    def event(self, kind: str, **data: object) -> None:
        if self._recording is not None or self._pre_roll_ns:
            event = Event(time.monotonic_ns(), kind, data)
            self._queue.put(event, EVENT_BYTES, reserve_bytes=EVENTS_RESERVE_BYTES)

    def settings_changed(self, settings: Settings) -> None:
        self._pre_roll_ns = self._thread.pre_roll.length_ns = round(
            settings.recorder.pre_roll_s * 1e9
        )

    def source_changed(self, source: SourceState) -> None:
        self.event("source", state=source.state, **reason_fields(source.reason))

    def reconstructs_with(self, profile: str, calibration_crc32: int) -> None:
        """Note the profile and calibration in use: another reference ends a recording,
        which contains the old one.
        """
        self.event("reconstruction", profile=profile, calibration_crc32=calibration_crc32)
        # Frames before it were published with another reference, which no recording can contain
        # beside its own.
        if calibration_crc32 != self._calibration_crc32:
            self._calibration_crc32 = calibration_crc32
            self._thread.pre_roll.oldest_ns = time.monotonic_ns()
        if self._recording is not None and calibration_crc32 != self._recording.calibration.crc32:
            self.end(Reason(ReasonCode.CALIBRATION_CHANGED, "the reference or calibration changed"))

    def now(self) -> Recorded | None:
        return self._recording.now() if self._recording else None

    def health(self) -> dict[str, int]:
        """Frames written and dropped since the start, frames waiting, and the pre-roll."""
        recording, now, pre_roll = self._recording, self.now(), self._thread.pre_roll
        counts = {
            "written": self._counts["written"] + (now.frames if now else 0),
            "dropped": self._counts["dropped"] + (now.dropped if now else 0),
            "waiting": len(self._queue) + len(pre_roll.kept) if recording else 0,
        }
        if self._pre_roll_ns:
            counts["pre_roll"] = 0 if recording else pre_roll.frames
            counts["pre_roll_dropped"] = self._refused + pre_roll.given_up
        return counts

    def poll(self) -> None:
        """End a recording that is over, answer the request to stop it,
        and publish ``status/recorder``.
        """
        self._look_at_clock()
        # In the main thread, which alone begins and ends recordings: `record` only sets `done`.
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

    def _look_at_clock(self) -> None:
        """Note a jump of the machine's clock: the frames' times go on, on a clock of their own, and
        the Unix times of a recording are all by the offset of its beginning.
        """
        before_ns, self._wall_minus_t_ns = self._wall_minus_t_ns, _wall_minus_t_ns()
        jump_ns = self._wall_minus_t_ns - before_ns
        if abs(jump_ns) >= _JUMP_NS:
            _log.warning("the clock was set by %+.1f s", jump_ns / 1e9)
            self.event("clock", jump_s=round(jump_ns / 1e9, 3), wall_ns=time.time_ns())

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
