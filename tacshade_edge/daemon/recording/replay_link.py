"""A replay's connection to the broker: the daemon's publisher and link, under a separate sensor id."""

from __future__ import annotations

import threading
import time
from typing import Any

from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.daemon.pipeline.observer import FrameResult
from tacshade_edge.daemon.publishing.publisher import Publisher
from tacshade_edge.daemon.recording.playback import Playback
from tacshade_edge.devices.mqtt.client import BrokerAddress
from tacshade_edge.devices.mqtt.link import MqttLink
from tacshade_edge.devices.mqtt.topic_slot import PayloadOutcome
from tacshade_edge.errors import DeviceError
from tacshade_edge.protocol import messages, requests
from tacshade_edge.protocol.requests import Request
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.types import Reconstruction
from tacshade_edge.version import installed_version

CONNECT_S, HAND_OVER_S, STOP_S = 2.0, 5.0, 2.0
PLAYBACK_PERIOD_S = 0.25
REPLAY = Reason(ReasonCode.REPLAY, "replay")


class ReplayLink:
    """Publishes what `run` would: every frame in contact, and the contact numbers in between.

    Parameters
    ----------
    broker : BrokerAddress
    sensor_id : str
    reconstructor : Reconstructor
    wait : bool
        Wait until the socket has taken each payload, so that none is superseded; False: the newest wins, as in `run`.

    Raises
    ------
    ConfigError
        The host name can never work.
    """

    def __init__(self, *, broker: BrokerAddress, sensor_id: str, reconstructor: Reconstructor, wait: bool) -> None:
        self._where = f"{broker['host']}:{broker['port']}"
        self._calibration = reconstructor.calibration
        self._profile = reconstructor.profile.name
        self._wait = wait
        self._changed = threading.Condition()
        self._open = 0
        self._began_s = 0.0
        self._frames = 0
        self._link = MqttLink(
            **broker,
            base_topic=f"tacshade/{sensor_id}",
            client_id=f"tacshade-replay-{sensor_id}",
            on_request=self._on_request,
            on_outcome=self._on_outcome,
        )
        self._playback: Playback | None = None
        self._reported_s = 0.0
        self._publisher = Publisher(self._offer, self._link.publish_event, lambda *_: None)

    def obey(self, playback: Playback) -> None:
        """Let ``req/replay`` control this playback."""
        self._playback = playback

    def report_playback(self, status: dict[str, Any]) -> None:
        """Publish the retained ``status/replay``."""
        state = "paused" if status["paused"] else "playing"
        details = {key: value for key, value in status.items() if key != "paused"}
        self._link.set_retained("status/replay", messages.encode_status(state, None, details))

    def start(self) -> None:
        """Connect. Raises DeviceError: unlike the daemon, a replay does not wait for a broker that is away."""
        info = messages.encode_info(
            version=installed_version(), config_digest="replay", profile=self._profile, calibration=self._calibration
        )
        self._link.set_retained("info", info)
        self._link.set_retained("status/camera", messages.encode_status("streaming", REPLAY))
        self._link.start()
        deadline_s = time.monotonic() + CONNECT_S
        pause = threading.Event()
        while not self._link.connected:
            if time.monotonic() > deadline_s:
                reason = self._link.reason or Reason(ReasonCode.NO_ANSWER, "no answer")
                expected = f"expected a connection to the broker at {self._where} within {CONNECT_S:.0f} s"
                raise DeviceError(f"{reason}; {expected}", code=reason.code)
            pause.wait(0.02)
        self._began_s = time.monotonic()

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Publish a result. Raises DeviceError if it must wait and the broker takes nothing."""
        self._frames += 1
        self._publisher.fps = self._frames / max(1e-3, time.monotonic() - self._began_s)
        self._publisher.see(FrameResult(recorded.frame, self._calibration, result))
        if self._playback is not None and (now_s := time.monotonic()) > self._reported_s + PLAYBACK_PERIOD_S:
            self._reported_s = now_s
            self.report_playback(self._playback.status())
        if self._wait:
            with self._changed:
                if not self._changed.wait_for(lambda: self._open == 0, HAND_OVER_S):
                    found = f"{self._where}: the broker accepted no message for {HAND_OVER_S:.0f} s"
                    raise DeviceError(found, code=ReasonCode.STALLED)

    def counters(self) -> dict[str, int]:
        """Number of payloads so far: published, superseded, failed, and the link's other counts."""
        return self._link.counters()

    def stop(self) -> None:
        """Publish the end and disconnect."""
        self._link.set_retained("status/camera", messages.encode_status("ended", REPLAY))
        if self._playback is not None:
            self._link.set_retained("status/replay", messages.encode_status("ended", REPLAY))
        self._link.stop(STOP_S)

    def _offer(self, stream: str, payload: bytes, seq: int) -> None:
        with self._changed:
            self._open += 1
        self._link.offer(stream, payload, seq)

    def _on_outcome(self, stream: str, seq: int, outcome: PayloadOutcome) -> None:
        with self._changed:
            self._open -= 1
            self._changed.notify_all()

    def _on_request(self, request: Request) -> None:
        if request.playback is not None and self._playback is not None:
            self._reported_s = 0.0
            status = self._playback.command(request.playback)
            self._link.reply(request, requests.encode_reply(request, status))
            return
        refusal = Reason(
            ReasonCode.UNAVAILABLE, "a replay does not accept this request (replay --play accepts req/replay)"
        )
        self._link.reply(request, requests.encode_error(request.transaction, refusal))
