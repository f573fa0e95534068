"""What the broker keeps of a sensor: its state in ``state``, ``status/camera`` and
``status/broker``, which the log reports, too, and what it is in ``info``.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from tacshade_edge.daemon.active_profile import ActiveProfile
from tacshade_edge.fixes import with_fix
from tacshade_edge.mqtt.link import MqttLink
from tacshade_edge.pipeline.observer import SourceState
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.settings import Settings, Source, digest
from tacshade_edge.version import installed_version
from tacshade_edge.wire import messages

_log = logging.getLogger(__name__)

STALL_S = 3.0


def encoded_info(
    settings: Settings, active: ActiveProfile, reference: dict[str, Any] | None
) -> bytes:
    """The message ``info``."""
    reconstructor = active.reconstructor
    return messages.encode_info(
        version=installed_version(),
        config_digest=digest(settings),
        profile=active.name,
        calibration=reconstructor
        if isinstance(reconstructor, Reason)
        else reconstructor.calibration,
        profiles=active.choices,
        choice=active.choice,
        reference=reference,
        hand_id=settings.hand_id,
        hand_T_sensor=settings.hand_T_sensor,
    )


class SensorState:
    """Publishes each state of the source and of the broker's limits once.

    The main thread publishes; any thread may call `now`. `last_frame_ns` and `unusable` give the
    time of the latest frame, and why none can be used; `changed` receives each published state.
    """

    def __init__(
        self,
        link: MqttLink,
        settings: Source,
        last_frame_ns: Callable[[], int],
        unusable: Callable[[], Reason | None],
        changed: Callable[[SourceState], None],
    ) -> None:
        self._link = link
        self._settings = settings
        self._last_frame_ns = last_frame_ns
        self._unusable = unusable
        self._changed = changed
        self.source = SourceState("away", Reason(ReasonCode.STARTING, "starting"))
        self.published: SourceState | None = None
        self._published_limit: Reason | None = None

    def now(self) -> SourceState:
        """The source's state, including what only the clock and the reconstruction show:
        a stall, unusable frames.
        """
        # A read that hangs reports nothing, so only the clock shows it.
        silent_s = (time.monotonic_ns() - self._last_frame_ns()) / 1e9
        if self.source.state == "streaming" and silent_s > STALL_S:
            stalled = Reason(ReasonCode.STALLED, f"no frame for more than {STALL_S:.0f} s")
            return SourceState("away", stalled, self.source.details)
        unusable = self._unusable()
        if self.source.state == "streaming" and unusable:
            return SourceState("unusable", unusable, self.source.details)
        return self.source

    def publish(self, state: SourceState | None = None) -> None:
        """Publish what has changed; `state` takes the place of the one now."""
        camera, limit = state or self.now(), self._link.limited
        # The loop asks several times a second; only changes go out.
        if camera == self.published and limit == self._published_limit:
            return
        if camera != self.published:
            self.published = camera
            self._changed(camera)
            reason = camera.reason
            if (
                reason is None
                or reason.code is ReasonCode.STARTING
                or camera.state not in ("away", "unusable")
            ):
                _log.info("source %s%s", camera.state, f": {reason}" if reason else "")
            else:
                fix = self._settings.how_to_fix(reason.code)
                _log.warning("source %s: %s", camera.state, with_fix(reason, fix))
            self._link.set_retained(
                "status/camera", messages.encode_status(camera.state, camera.reason, camera.details)
            )
        if limit != self._published_limit:
            self._published_limit = limit
            self._link.set_retained(
                "status/broker", messages.encode_status("limited" if limit else "connected", limit)
            )
        # The link itself publishes `stopped` as it ends.
        if camera.state != "ended":
            sound = camera.state == "streaming" and limit is None
            self._link.set_retained("state", b"online" if sound else b"degraded")
