"""Handles ``req/record`` and publishes ``status/recorder``; runs in the main thread."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec

from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.daemon.observer import RECORDED_S, FrameObserver, SourceState
from tacshade_edge.daemon.record import STOPPED, LiveRecorder, Recorded
from tacshade_edge.daemon.requests import Reply
from tacshade_edge.errors import DeviceError, TacshadeError
from tacshade_edge.protocol.messages import encode_status
from tacshade_edge.protocol.requests import Request
from tacshade_edge.reasons import ReasonCode, reason_fields
from tacshade_edge.settings import Settings, to_yaml
from tacshade_edge.storage.recording.recorder import McapRecorder, Recorder
from tacshade_edge.storage.recording.recording_content import CALIBRATION_NAME
from tacshade_edge.types import Frame
from tacshade_edge.version import installed_version

FIGURES_PERIOD_S = 1.0
_log = logging.getLogger(__name__)


class RecordRequests(FrameObserver):
    """Handles requests; each gets exactly one reply, for ``stop`` when everything is written."""

    health_key = "recorder"
    stop_s = RECORDED_S

    def __init__(self, recorder: LiveRecorder, reply: Reply, publish: Callable[[bytes], None]) -> None:
        self._recorder = recorder
        self._reply = reply
        self._publish = publish
        self._stop: Request | None = None
        self._latest: Recorded | None = None
        self._published, self._published_s = b"", 0.0
        self._published_folder: Path | None = None
        self._began_s = self._length_s = 0.0

    def handle(self, request: Request, settings: Settings, reconstructor: Reconstructor, source: SourceState) -> None:
        try:
            if request.action == "start":
                folder = self._start(request, settings, reconstructor, source)
                self._reply(request, {"folder": str(folder)})
            elif request.action == "mark":
                self._reply(request, self._mark(request.text))
            else:
                self._end(request)
        except TacshadeError as error:
            _log.info("rejected req/record: %s", error)
            self._reply(request, error.reason)
        self.poll()

    @property
    def tap(self) -> Callable[[Frame], None] | None:
        """The function that records a frame, while a recording runs or a pre-roll is kept."""
        return self._recorder.tap

    def health(self) -> dict[str, int]:
        return self._recorder.counts()

    def settings_changed(self, settings: Settings) -> None:
        self._recorder.keep_pre_roll(settings.recorder.pre_roll_s)

    def source_changed(self, source: SourceState) -> None:
        self._recorder.event("source", state=source.state, **reason_fields(source.reason))

    def stop(self, timeout_s: float) -> None:
        """Wait until the recording is written, and answer a ``stop`` request."""
        self._recorder.join(timeout_s)
        self.poll()

    def poll(self) -> None:
        recorded = self._recorder.poll()
        if recorded is not None:
            self._latest = recorded
            _log.info("recording ended: %s", recorded.as_dict())
            if (request := self._stop) is not None:
                self._stop = None
                self._reply(request, recorded.as_dict())
        now, latest = self._recorder.now(), self._latest
        if now is not None:
            seconds = {"seconds": round(time.monotonic() - self._began_s, 1), "of_seconds": self._length_s}
            status = encode_status("recording", None, {**now.as_dict(), **seconds})
        elif latest is None:
            status = encode_status("idle")
        else:
            state, reason = ("stopped", latest.ending) if latest.failed else ("idle", None)
            status = encode_status(state, reason, latest.as_dict())
        now_s = time.monotonic()
        going_on = now is not None and self._published_folder == now.folder
        if status == self._published or (going_on and now_s < self._published_s + FIGURES_PERIOD_S):
            return
        self._published, self._published_s, self._published_folder = status, now_s, now.folder if now else None
        self._publish(status)

    def _start(self, request: Request, settings: Settings, reconstructor: Reconstructor, source: SourceState) -> Path:
        name = request.name or time.strftime("%Y%m%d-%H%M%S", time.gmtime())
        folder = Path(settings.recorder.folder) / name
        calibration, profile = reconstructor.calibration, reconstructor.profile.name
        about = {"version": installed_version(), "profile": profile, "calibration_crc32": calibration.crc32}
        make = Recorder if request.format == "folder" else partial(McapRecorder, sensor_id=settings.sensor_id)
        try:
            self._recorder.start(folder, request.seconds, _replayable(settings), calibration, about, make)
        except DeviceError as error:
            if error.code != ReasonCode.DISK:
                raise
            fix = "set recorder.folder to a folder that the daemon can write to"
            raise DeviceError(f"{error}; {fix}", code=error.code) from None
        self._began_s, self._length_s = time.monotonic(), request.seconds
        state = {"state": source.state, **reason_fields(source.reason)}
        self._recorder.event("start", wall_ns=time.time_ns(), **state, source=source.details, **about)
        _log.info("recording to %s", folder)
        return folder

    def _mark(self, text: str) -> dict[str, str | int]:
        now = self._recorder.now()
        if now is None:
            raise DeviceError("found no recording to mark", code=ReasonCode.NO_RECORDING)
        self._recorder.event("mark", text=text)
        return {"folder": str(now.folder), "frames": now.frames}

    def _end(self, request: Request) -> None:
        if self._stop is not None:
            raise DeviceError("busy: the recording is already stopping", code=ReasonCode.BUSY)
        if self._recorder.now() is None:
            raise DeviceError("found no recording to stop", code=ReasonCode.NO_RECORDING)
        self._stop = request
        self._recorder.end(STOPPED)


def _replayable(settings: Settings) -> str:
    return to_yaml(msgspec.structs.replace(settings, calibration=CALIBRATION_NAME))
