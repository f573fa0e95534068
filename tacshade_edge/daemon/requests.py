"""What ``req/<verb>`` does; runs in the main thread."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from tacshade_edge.core.profiles import AUTO
from tacshade_edge.daemon.pipeline.workers import Reconstruct
from tacshade_edge.daemon.profiles.active_profile import ActiveProfile
from tacshade_edge.daemon.reference import REFERENCE_FRAMES, ReferenceCollector
from tacshade_edge.devices.files.calibration_file import with_crc
from tacshade_edge.errors import ConfigError
from tacshade_edge.protocol.messages import Request, encode_error, encode_result
from tacshade_edge.types import U8

_log = logging.getLogger(__name__)

REFERENCE_TIMEOUT_S = 5.0


class Requests:
    """Handles requests; each gets exactly one reply.

    Parameters
    ----------
    worker : Reconstruct
        Gives the frames for a new reference.
    active : ActiveProfile
        Changed by `profile` and `reference`.
    reply : callable
        ``reply(request, payload)``.
    status : callable
        The answer to ``status``.
    changed : callable
        Called after the reconstructor was replaced.
    record, stitch : callable
        Do and answer the verbs of their names.
    """

    def __init__(
        self,
        worker: Reconstruct,
        active: ActiveProfile,
        reply: Callable[[Request, bytes], None],
        status: Callable[[], dict[str, Any]],
        changed: Callable[[], None],
        record: Callable[[Request], None],
        stitch: Callable[[Request], None],
    ) -> None:
        self._worker = worker
        self._active = active
        self._reply = reply
        self._status = status
        self._changed = changed
        self._record = record
        self._stitch = stitch
        self._reference: tuple[Request, float] | None = None  # and its deadline
        self._taken: tuple[list[U8], str] | None = None  # set by the reconstruct thread, once

    def handle(self, request: Request) -> None:
        """Do or refuse one request."""
        if request.verb == "status":
            self._reply(request, encode_result(request.transaction, self._status()))
        elif request.verb == "record":
            self._record(request)
        elif request.verb == "stitch":
            self._stitch(request)
        elif request.verb == "profile":
            self._set_profile(request)
        else:
            self._take_reference(request)

    def poll(self) -> None:
        """Finish a reference that was taken, or that nothing came for."""
        if self._reference is None:
            return
        request, deadline_s = self._reference
        if self._taken is None and time.monotonic() < deadline_s:
            return
        images, reason = self._taken or ([], f"fewer than {REFERENCE_FRAMES} frames in {REFERENCE_TIMEOUT_S:.0f} s")
        self._worker.watch = self._reference = self._taken = None
        self._set_reference(request, images, reason)

    def _set_profile(self, request: Request) -> None:
        if request.profile not in self._active.choices:
            expected = f"one of {', '.join(self._active.choices)}"
            if request.profile == AUTO:
                expected += "; the settings give no latency budget"
            self._refuse(request, f"profile: found {request.profile}, expected {expected}")
            return
        self._active.choose(request.profile)
        self._changed()
        _log.info("profile is now %s", request.profile)
        profile = self._active.reconstructor.profile.name
        self._reply(request, encode_result(request.transaction, {"profile": profile}))

    def _take_reference(self, request: Request) -> None:
        if self._reference is not None:
            self._refuse(request, "busy: a reference is being taken")
            return
        self._reference = request, time.monotonic() + REFERENCE_TIMEOUT_S
        self._worker.watch = ReferenceCollector(self._on_taken).watch

    def _on_taken(self, images: list[U8], reason: str) -> None:
        self._taken = images, reason

    def _set_reference(self, request: Request, images: list[U8], reason: str) -> None:
        if reason:
            self._refuse(request, reason)
            return
        from tacshade_edge.core.calibration.calibrate import rezero  # on demand: few daemons ever calibrate

        try:
            calibration = with_crc(rezero(self._active.reconstructor.calibration, images))
        except ConfigError as error:
            self._refuse(request, str(error))
            return
        self._active.use(calibration)
        self._changed()
        _log.info("new reference from %d frames, until the next start", len(images))
        result = {"frames": len(images), "calibration_crc32": calibration.crc32, "noise_grey": calibration.noise_grey}
        self._reply(request, encode_result(request.transaction, result))

    def _refuse(self, request: Request, reason: str) -> None:
        _log.info("req/%s refused: %s", request.verb, reason)
        self._reply(request, encode_error(request.transaction, reason))
