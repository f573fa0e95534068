"""Carries out requests, from MQTT and from the robot alike, in the main thread."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tacshade_edge.daemon.active_profile import ActiveProfile
from tacshade_edge.daemon.live_recorder import LiveRecorder
from tacshade_edge.daemon.reference_in_use import References
from tacshade_edge.pipeline.observer import Reply, SourceState
from tacshade_edge.quoting import shown
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.profiles import AUTO
from tacshade_edge.settings import Settings
from tacshade_edge.wire.requests import Request
from tacshade_edge.wire.results import ProfileChosen

if TYPE_CHECKING:
    from tacshade_edge.stitching.session_worker import Sessions

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class RequestHandler:
    """Passes each request to the part that carries it out.

    `settings`, `source` and `status` give what is so now; `changed` publishes that the
    reconstructor was replaced.
    """

    active: ActiveProfile
    recorder: LiveRecorder
    references: References
    sessions: Sessions | None
    settings: Callable[[], Settings]
    source: Callable[[], SourceState]
    status: Callable[[], dict[str, Any]]
    changed: Callable[[], None]

    def handle(self, request: Request, reply: Reply) -> None:
        """Carry out a request; it gets exactly one reply, perhaps later."""
        running = self.active.reconstructor
        if request.verb == "status":
            reply(self.status())
        elif request.verb == "replay":  # only `replay --play` accepts it
            reply(Reason(ReasonCode.UNAVAILABLE, "this daemon is not playing a recording"))
        # Whatever follows needs a calibration.
        elif isinstance(running, Reason):
            reply(running)
        elif request.verb == "record":
            self.recorder.handle(request, reply, self.settings(), running, self.source())
        elif request.verb == "profile":
            reply(self._choose_profile(request.profile))
        elif request.verb == "reference":
            self.references.handle(reply)
        elif self.sessions is not None:
            self.sessions.handle(request, reply)
        else:
            text = (
                "found no source of poses, expected `serial` in the settings or a recording with "
                "poses"
            )
            reply(Reason(ReasonCode.UNAVAILABLE, text))

    def _choose_profile(self, name: str) -> ProfileChosen | Reason:
        if name not in self.active.choices:
            expected = f"one of {', '.join(self.active.choices)}"
            if name == AUTO:
                expected += "; the settings give no latency budget"
            return Reason(
                ReasonCode.UNKNOWN_PROFILE, f"profile: found {shown(name, 60)}, expected {expected}"
            )
        self.active.choose(name)
        # After the choice: `info` and the recorder take note of what runs now.
        self.changed()
        _log.info("using profile %s", name)
        return ProfileChosen(self.active.name)
