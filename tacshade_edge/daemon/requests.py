"""Handles ``req/<verb>``; runs in the main thread."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from typing import Any

from tacshade_edge.core.profiles import AUTO
from tacshade_edge.daemon.observer import FrameObserver, FrameResult
from tacshade_edge.daemon.profiles import ActiveProfile
from tacshade_edge.daemon.references import REFERENCE_FRAMES, ReferenceCollector, References
from tacshade_edge.errors import ConfigError
from tacshade_edge.protocol.requests import Request
from tacshade_edge.protocol.results import ProfileChosen, RequestResult
from tacshade_edge.quoting import shown
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import U8, Need

_log = logging.getLogger(__name__)

REFERENCE_TIMEOUT_S = 5.0

Reply = Callable[[Request, RequestResult | Mapping[str, Any] | Reason], None]
"""``reply(request, outcome)``: the result, or the reason that there is none."""


class Requests(FrameObserver):
    """Handles requests, each with exactly one reply; `changed` is called after the reconstructor was replaced."""

    def __init__(
        self,
        active: ActiveProfile,
        references: References,
        reply: Reply,
        status: Callable[[], dict[str, Any]],
        changed: Callable[[], None],
        others: Mapping[str, Callable[[Request], None]],
    ) -> None:
        self._active = active
        self._references = references
        self._reply = reply
        self._status = status
        self._changed = changed
        self._others = others
        self._collector: ReferenceCollector | None = None
        self._reference: tuple[Request, float] | None = None  # and its deadline

    def handle(self, request: Request) -> None:
        reconstructor = self._active.reconstructor
        if request.verb == "status":
            self._reply(request, self._status())
        elif request.verb == "replay":  # only `replay --play` accepts it
            self._refuse(request, Reason(ReasonCode.UNAVAILABLE, "this daemon is not playing a recording"))
        elif isinstance(reconstructor, Reason):
            self._refuse(request, reconstructor)
        elif request.verb in self._others:
            self._others[request.verb](request)
        elif request.verb == "stitch":
            text = "found no source of poses, expected `serial` in the settings or a recording with poses"
            self._refuse(request, Reason(ReasonCode.UNAVAILABLE, text))
        elif request.verb == "profile":
            self._set_profile(request)
        else:
            self._take_reference(request)

    def need(self) -> Need:
        return Need.CONTACT if self._collector is None else Need.DEPTH

    def see(self, seen: FrameResult) -> None:
        if (collector := self._collector) is not None and seen.reconstruction is not None:
            collector.see(seen.frame, seen.reconstruction)

    def poll(self) -> None:
        if self._reference is None or self._collector is None:
            return
        (request, deadline_s), taken = self._reference, self._collector.outcome
        if taken is None and time.monotonic() < deadline_s:
            return
        self._collector = self._reference = None
        if taken is None:
            text = f"received fewer than {REFERENCE_FRAMES} frames within {REFERENCE_TIMEOUT_S:.0f} s"
            taken = Reason(ReasonCode.TIMEOUT, text)
        if isinstance(taken, Reason):
            self._refuse(request, taken)
        else:
            self._set_reference(request, taken)

    def _set_profile(self, request: Request) -> None:
        if request.profile not in self._active.choices:
            expected = f"one of {', '.join(self._active.choices)}"
            if request.profile == AUTO:
                expected += "; the settings give no latency budget"
            text = f"profile: found {shown(request.profile, 60)}, expected {expected}"
            self._refuse(request, Reason(ReasonCode.UNKNOWN_PROFILE, text))
            return
        self._active.choose(request.profile)
        self._changed()
        _log.info("using profile %s", request.profile)
        self._reply(request, ProfileChosen(self._active.name))

    def _take_reference(self, request: Request) -> None:
        if self._reference is not None:
            self._refuse(request, Reason(ReasonCode.BUSY, "busy: already taking a reference"))
            return
        self._reference = request, time.monotonic() + REFERENCE_TIMEOUT_S
        self._collector = ReferenceCollector()

    def _set_reference(self, request: Request, images: list[U8]) -> None:
        try:
            taken = self._references.take(images)
        except ConfigError as error:
            self._refuse(request, Reason(ReasonCode.REFERENCE_INVALID, str(error)))
            return
        self._active.use(self._references.calibration)
        self._changed()
        self._reply(request, taken)

    def _refuse(self, request: Request, reason: Reason) -> None:
        _log.info("rejected req/%s: %s", request.verb, reason)
        self._reply(request, reason)
