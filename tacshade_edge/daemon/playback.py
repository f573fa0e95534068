"""Replays a recording through the reconstructor and publisher, every frame in order,
by the recording's clock.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from tacshade_edge.errors import ConfigError, DecodeError, DeviceError
from tacshade_edge.mqtt.client import BrokerAddress
from tacshade_edge.mqtt.link import MqttLink
from tacshade_edge.mqtt.outgoing import PayloadOutcome
from tacshade_edge.mqtt.publishing import Publisher
from tacshade_edge.pipeline.ledger import StageTimer, Timings
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.recording.recording import RecordedFrame, Recording
from tacshade_edge.sensor.contact.tracking import ContactTracker
from tacshade_edge.sensor.reconstruct import Reconstructor, step_and_track
from tacshade_edge.types import Reconstruction
from tacshade_edge.version import installed_version
from tacshade_edge.wire import messages, requests
from tacshade_edge.wire.requests import PlaybackCommand, Request

Deliver = Callable[[RecordedFrame, Reconstruction], None]


@dataclass(slots=True)
class PlaybackProgress:
    """The progress of a replay; `seconds` are ours, with waits,
    undecodable images are not among the frames.
    """

    frames: int = 0
    contacts: int = 0
    touched: int = 0  # with an unknown depth
    invalid: int = 0
    undecodable: int = 0
    first_ns: int = 0
    last_ns: int = 0
    seconds: float = 0.0
    timings: Timings = field(default_factory=Timings)

    @property
    def answers(self) -> str:
        """How many frames are in contact, and in how many something touches at an unknown depth."""
        touched = f", {self.touched} touched (depth unknown)" if self.touched else ""
        return f"{self.contacts} in contact{touched}"

    @property
    def recorded_seconds(self) -> float:
        """Duration by the recording's clock, s, including the last frame's mean period."""
        # One frame has no period.
        if self.frames <= 1:
            return 0.0
        return (self.last_ns - self.first_ns) / 1e9 * self.frames / (self.frames - 1)

    @property
    def speed_up(self) -> float:
        return self.recorded_seconds / self.seconds if self.seconds > 0 else 0.0

    def as_dict(self) -> dict[str, Any]:
        return {
            "frames": self.frames,
            "seconds": round(self.seconds, 4),
            "recorded_seconds": round(self.recorded_seconds, 4),
            "speed_up": round(self.speed_up, 3),
            "stages_ms": self.timings.percentiles(),
        }


def replay(
    recording: Recording | Playback,
    reconstructor: Reconstructor,
    sinks: Sequence[Deliver],
    progress: PlaybackProgress,
    *,
    speed: float | None,
    undecodable: Callable[[str], None],
) -> None:
    """Reconstruct every frame and deliver it to every sink, in order; `speed` None is as fast as
    possible. `undecodable` receives a line about every unusable image.

    Raises ConfigError if the first image has another size than the calibration.
    """
    begin_ns = time.monotonic_ns()
    pause, tracker, timer = threading.Event(), ContactTracker(), StageTimer()
    while True:
        try:
            recorded = recording.read()
        except DecodeError as error:
            progress.undecodable += 1
            undecodable(str(error))
            continue
        if recorded is None:
            return
        frame = recorded.frame
        if progress.frames == 0:
            progress.first_ns = frame.t_ns
        if speed is not None:
            due_ns = begin_ns + (frame.t_ns - progress.first_ns) / speed
            wait_s = (due_ns - time.monotonic_ns()) / 1e9
            pause.wait(min(max(0.0, wait_s), threading.TIMEOUT_MAX))  # a table may state more
        timer.begin()
        result = step_and_track(reconstructor, tracker, frame, timer.mark)
        assert result is not None  # by default everything is needed
        reason = result.reason
        if progress.frames == 0 and reason is not None and reason.code is ReasonCode.SIZE:
            raise ConfigError(f"{recorded.name}: {reason.text}")
        for deliver in sinks:
            deliver(recorded, result)
        timer.mark("deliver")
        progress.timings.add(timer.ms)
        progress.frames += 1
        progress.contacts += result.contact
        progress.touched += result.touched
        progress.invalid += not result.valid
        progress.last_ns = frame.t_ns
        progress.seconds = (time.monotonic_ns() - begin_ns) / 1e9


Changed = Callable[[dict[str, Any]], None]
_MS: Final = 3  # decimals of a second
REPORT_PERIOD_S: Final = 1.0
"""How often the status is repeated while paused:
a slow page loses what comes faster than it can take.
"""


class Playback:
    """Plays a recording for a person (``req/replay``): provides each frame when it is due; the end
    is a pause. One thread calls `read`; any may call `command` and `status`. `changed` receives the
    status after every command, and at the end.
    """

    def __init__(self, reopen: Callable[[], Recording], speed: float, changed: Changed) -> None:
        self._reopen = reopen
        self._recording = reopen()
        self._changed = changed
        self._wake = threading.Condition()
        self._speed = speed
        self._paused = False
        self._steps = self._backs = 0
        self._seek_ns: int | None = None  # after the first frame
        # Our time and the recording's when the present pace began.
        self._start: tuple[int, int] | None = None
        self._first_ns: int | None = None
        self._last_ns = 0  # time of the latest frame that was shown
        self._seq: int | None = None

    def command(self, command: PlaybackCommand) -> dict[str, Any]:
        """Carry out a command and return the resulting status."""
        with self._wake:
            self._start = None
            # The pace begins anew with the next frame: counted from the old beginning, frames
            # would come in a burst after a pause or at another speed.
            paused = self._paused if command.paused is None else command.paused
            self._paused = paused or command.step or command.back
            self._steps += command.step
            self._backs += command.back
            self._speed = command.speed or self._speed
            if command.seek_s is not None:
                self._seek_ns = round(command.seek_s * 1e9)
            self._wake.notify_all()
        status = self.status()
        self._changed(status)
        return status

    def status(self) -> dict[str, Any]:
        """The content of ``status/replay``, without its state and reason."""
        with self._wake:
            return {
                "paused": self._paused,
                "speed": self._speed,
                "position_s": round((self._last_ns - (self._first_ns or 0)) / 1e9, _MS),
                "length_s": round(self._recording.length_ns / 1e9, _MS),
                "frame": self._seq,
            }

    def read(self) -> RecordedFrame:
        """Wait for the next frame to show.

        Raises DecodeError if its image cannot be used, and as `Recording` does.
        """
        ahead: RecordedFrame | None = None
        while True:
            wound = self._wound
            ahead = self._jump(ahead) if wound else ahead or self._recording.read()
            if ahead is None:
                self._end()
                continue
            t_ns = ahead.frame.t_ns
            with self._wake:
                if self._first_ns is None:
                    self._first_ns = t_ns
                # A command may have come while the frame was read.
                if self._wound:
                    continue
                wait_s = 0.0 if wound else self._wait_s(t_ns)
                if wait_s <= 0:
                    self._steps = max(self._steps - 1, 0)
                    self._last_ns, self._seq = t_ns, ahead.frame.seq
                    return ahead
                # A command ends the wait. While paused, it ends by itself to repeat the status.
                still_paused = not self._wake.wait(min(wait_s, REPORT_PERIOD_S)) and self._paused
            # Without the lock: it publishes, and commands must not wait for that.
            if still_paused:
                self._changed(self.status())

    @property
    def _wound(self) -> bool:
        """Whether a frame other than the next is requested."""
        return self._seek_ns is not None or self._backs > 0

    def _wait_s(self, t_ns: int) -> float:
        if self._paused:
            return 0.0 if self._steps else float("inf")
        now_ns = time.monotonic_ns()
        self._start = self._start or (now_ns, t_ns)
        return (self._start[0] + (t_ns - self._start[1]) / self._speed - now_ns) / 1e9

    def _jump(self, ahead: RecordedFrame | None) -> RecordedFrame | None:
        """The frame that was requested: at or after a time, or before the latest one shown,
        or the first.
        """
        with self._wake:
            self._start = None
            seek_ns, self._seek_ns = self._seek_ns, None
            backs, self._backs = self._backs, 0
        if seek_ns is None:
            self._recording = self._reopen()
            self._recording.skip_to(self._last_ns, frames=backs)
            return self._recording.read()
        # Recordings are read forwards only: for what lies behind, from the beginning.
        seek_ns += self._first_ns or 0
        if seek_ns <= max(self._last_ns, ahead.frame.t_ns if ahead else 0):
            self._recording = self._reopen()
        self._recording.skip_to(seek_ns)
        return self._recording.read()

    def _end(self) -> None:
        with self._wake:
            self._paused, self._steps = True, 0
        # A pause at the end, from which a person may go back.
        again = False
        while not again:
            self._changed(self.status())
            with self._wake:
                again = bool(
                    self._wake.wait_for(
                        lambda: not self._paused or self._steps or self._wound, REPORT_PERIOD_S
                    )
                )
        with self._wake:
            if not self._wound:
                # Play again from the first frame.
                self._seek_ns = 0


CONNECT_S, HAND_OVER_S, STOP_S = 2.0, 5.0, 2.0
PLAYBACK_PERIOD_S = 0.25
REPLAY = Reason(ReasonCode.REPLAY, "replay")


class ReplayLink:
    """Publishes what `run` would, under a separate sensor id;
    with `wait`, nothing is superseded.
    """

    def __init__(
        self, *, broker: BrokerAddress, sensor_id: str, reconstructor: Reconstructor, wait: bool
    ) -> None:
        self._where = f"{broker['host']}:{broker['port']}"
        self._calibration = reconstructor.calibration
        self._profile = reconstructor.profile.name
        self._wait = wait
        self._changed = threading.Condition()
        self._open = 0
        self._began_s = 0.0
        self._frames = 0
        self._link = MqttLink(
            broker,
            base_topic=f"tacshade/{sensor_id}",
            client_id=f"tacshade-replay-{sensor_id}",
            on_request=self._on_request,
            on_outcome=self._on_outcome,
        )
        self.playback: Playback | None = None
        self._reported_s = 0.0
        self._publisher = Publisher(self._offer, self._link.publish_event, lambda *_: None)

    def report_playback(self, status: dict[str, Any]) -> None:
        """Publish the retained ``status/replay``."""
        state = "paused" if status["paused"] else "playing"
        details = {key: value for key, value in status.items() if key != "paused"}
        self._link.set_retained("status/replay", messages.encode_status(state, None, details))

    def start(self) -> None:
        """Connect.

        Raises DeviceError: unlike the daemon, a replay does not wait for a broker that is away.
        """
        info = messages.encode_info(
            version=installed_version(),
            config_digest="replay",
            profile=self._profile,
            calibration=self._calibration,
        )
        self._link.set_retained("info", info)
        self._link.set_retained("status/camera", messages.encode_status("streaming", REPLAY))
        self._link.start()
        deadline_s = time.monotonic() + CONNECT_S
        pause = threading.Event()
        while not self._link.connected:
            if time.monotonic() > deadline_s:
                reason = self._link.reason or Reason(ReasonCode.NO_ANSWER, "no answer")
                expected = (
                    f"expected a connection to the broker at {self._where} within {CONNECT_S:.0f} s"
                )
                raise DeviceError(f"{reason}; {expected}", code=reason.code)
            pause.wait(0.02)
        self._began_s = time.monotonic()

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Publish a result. Raises DeviceError if it must wait and the broker takes nothing."""
        self._frames += 1
        self._publisher.fps = self._frames / max(1e-3, time.monotonic() - self._began_s)
        self._publisher.see(FrameResult(recorded.frame, self._calibration, result))
        if (
            self.playback is not None
            and (now_s := time.monotonic()) > self._reported_s + PLAYBACK_PERIOD_S
        ):
            self._reported_s = now_s
            self.report_playback(self.playback.status())
        if self._wait:
            with self._changed:
                if not self._changed.wait_for(lambda: self._open == 0, HAND_OVER_S):
                    found = f"{self._where}: the broker accepted no message for {HAND_OVER_S:.0f} s"
                    raise DeviceError(found, code=ReasonCode.STALLED)

    def counters(self) -> dict[str, int]:
        """Number of payloads so far: published, superseded, failed, and the link's other counts."""
        return self._link.counters()

    def stop(self) -> None:
        self._link.set_retained("status/camera", messages.encode_status("ended", REPLAY))
        if self.playback is not None:
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
        if request.playback is not None and self.playback is not None:
            self._reported_s = 0.0
            status = self.playback.command(request.playback)
            self._link.reply(request, requests.encode_reply(request, status))
            return
        refusal = Reason(
            ReasonCode.UNAVAILABLE,
            "a replay does not accept this request (replay --play accepts req/replay)",
        )
        self._link.reply(request, requests.encode_error(request.transaction, refusal))
