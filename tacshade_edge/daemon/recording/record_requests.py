"""What ``req/record`` does, and what ``status/recorder`` says; runs in the main thread."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from tacshade_edge import __version__
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.daemon.pipeline.workers import SourceState
from tacshade_edge.daemon.recording.record import STOPPED, LiveRecorder, Recorded, RecorderBusyError
from tacshade_edge.daemon.requests import Reply
from tacshade_edge.devices.files.recorder import CALIBRATION_NAME
from tacshade_edge.errors import ConfigError, TacshadeError
from tacshade_edge.protocol.messages import Request, encode_status
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.settings import Settings, to_yaml

FIGURES_PERIOD_S = 1.0
_log = logging.getLogger(__name__)


class RecordRequests:
    """Handles requests; each gets exactly one reply, that to ``stop`` when all is written.

    Parameters
    ----------
    recorder : LiveRecorder
    reply : Reply
    tell : callable
        ``tell(status_payload)``.
    """

    def __init__(self, recorder: LiveRecorder, reply: Reply, tell: Callable[[bytes], None]) -> None:
        self._recorder = recorder
        self._reply = reply
        self._tell = tell
        self._stop: Request | None = None
        self._latest: Recorded | None = None
        self._told, self._told_s = b"", 0.0
        self._told_folder: Path | None = None

    def handle(self, request: Request, settings: Settings, reconstructor: Reconstructor, source: SourceState) -> None:
        """Do or refuse one request."""
        outcome: dict[str, str] | Reason | None
        if request.action == "start":
            outcome = self._start(request, settings, reconstructor, source)
        else:
            outcome = self._end(request)
        if isinstance(outcome, Reason):
            _log.info("req/record refused: %s", outcome)
        if outcome is not None:
            self._reply(request, outcome)
        self.poll()

    def poll(self) -> None:
        """Tell what changed; answer a ``stop`` whose recording is written."""
        recorded = self._recorder.poll()
        if recorded is not None:
            self._latest = recorded
            _log.info("recording ended: %s", recorded.as_dict())
            if (request := self._stop) is not None:
                self._stop = None
                self._reply(request, recorded.as_dict())
        now, latest = self._recorder.now(), self._latest
        if now is not None:
            status = encode_status("recording", "", now.as_dict())
        elif latest is None:
            status = encode_status("idle")
        else:
            status = encode_status(
                "stopped" if latest.failed else "idle", latest.ending if latest.failed else "", latest.as_dict()
            )
        now_s = time.monotonic()
        going_on = now is not None and self._told_folder == now.folder
        if status == self._told or (going_on and now_s < self._told_s + FIGURES_PERIOD_S):
            return
        self._told, self._told_s, self._told_folder = status, now_s, now.folder if now else None
        self._tell(status)

    def _start(
        self, request: Request, settings: Settings, reconstructor: Reconstructor, source: SourceState
    ) -> dict[str, str] | Reason:
        name = request.name or time.strftime("%Y%m%d-%H%M%S", time.gmtime())
        folder = Path(settings.recorder.folder) / name
        calibration, profile = reconstructor.calibration, reconstructor.profile.name
        about = {"version": __version__, "profile": profile, "calibration_crc32": calibration.crc32}
        try:
            self._recorder.start(folder, request.seconds, _replayable(settings), calibration, about)
        except RecorderBusyError as error:
            return Reason(ReasonCode.BUSY, str(error))
        except ConfigError as error:
            return Reason(ReasonCode.NAME_TAKEN, str(error))
        except TacshadeError as error:
            return Reason(ReasonCode.DEVICE_FAILED, str(error))
        self._recorder.event("start", state=source.state, reason=source.reason, source=source.details, **about)
        _log.info("recording to %s", folder)
        return {"folder": str(folder)}

    def _end(self, request: Request) -> Reason | None:
        if self._stop is not None:
            return Reason(ReasonCode.BUSY, "busy: the recording is being stopped")
        if self._recorder.now() is None:
            return Reason(ReasonCode.NO_RECORDING, "found no recording to stop")
        self._stop = request
        self._recorder.end(STOPPED)
        return None


def _replayable(settings: Settings) -> str:
    """The settings file of a recording: with the calibration that lies beside it."""
    return to_yaml(msgspec.structs.replace(settings, calibration=CALIBRATION_NAME))
