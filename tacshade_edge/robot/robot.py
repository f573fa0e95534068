"""The robot next to the sensor: the part of the daemon that exists only with ``serial``
in the settings.

Several sensors' processes may share a robot's line: one has the port, answers commands, and
forwards what it hears, so that all have the same clock and poses. Each follower has its own pair of
datagram sockets; a pose that finds no room is lost to it.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

import msgspec

from tacshade_edge.pipeline.observer import (
    SERIAL_STOPPED_S,
    FrameObserver,
    FrameResult,
    Reply,
    SourceState,
)
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.placed_frames import PlacedFrames
from tacshade_edge.robot.port import SerialPort
from tacshade_edge.robot.robot_motion import (
    ClockExchanged,
    Heard,
    PoseHeard,
    RobotMotion,
    RobotRestarted,
)
from tacshade_edge.robot.serial_commands import SerialCommands
from tacshade_edge.robot.serial_line import LineState, PortState, SerialChannel
from tacshade_edge.robot.touch_events import TouchEvents
from tacshade_edge.settings import Document
from tacshade_edge.types import Frame, Need
from tacshade_edge.wire.messages import encode_status
from tacshade_edge.wire.requests import Request

# How long a frame waits for the pose after it: enough if the robot sends ten a second.
POSE_WAIT_NS = 120_000_000
# A robot repeats SYNC at least once a second, so by then three are missing.
SILENT_NS = 3_000_000_000
# FTDI chips hold bytes back for 16 ms, unless their driver is set to send after 1 ms.
LATENCY_MAX_MS = 1
# Frames whose pose is remembered: 17 s at 60 frames/s, longer than a session or the recorder lags.
_POSES_KEPT: Final = 1024
_BYTES_MAX: Final = 1 << 14
# How late a follower notices `stop`, which has 0.2 s.
_READ_S: Final = 0.05
# Well below `SILENT_NS`, after which a follower takes the owner for dead.
_LINE_PERIOD_NS: Final = 1_000_000_000
_decoder: Final = msgspec.msgpack.Decoder(PoseHeard | ClockExchanged | RobotRestarted | LineState)


@dataclass(frozen=True, slots=True, eq=False)
class SharedLine:
    """A sensor's part in a shared line: the owner's `ends`,
    or the socket on which a follower `hears` the owner.
    """

    owner: str
    ends: tuple[socket.socket, ...] = ()
    hears: socket.socket | None = None

    def forward(self, message: Heard | LineState) -> None:
        payload = msgspec.msgpack.encode(message)
        for end in self.ends:
            with contextlib.suppress(OSError):
                end.send(payload)


def share_lines(documents: Sequence[Document]) -> dict[str, SharedLine]:
    """Each sensor's part in a port that several name; the first of them has the port.

    Other sensors are left out.
    """
    names: dict[str, list[str]] = {}
    for document in documents:
        if (serial := document.settings.serial) is not None:
            names.setdefault(serial.device, []).append(document.settings.sensor_id)
    shared: dict[str, SharedLine] = {}
    for owner, *followers in names.values():
        ends = []
        for name in followers:
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            # The serial thread of the owner must not wait for a follower that hangs.
            ours.setblocking(False)
            ends.append(ours)
            shared[name] = SharedLine(owner, hears=theirs)
        if followers:
            shared[owner] = SharedLine(owner, tuple(ends))
    return shared


class FollowingChannel:
    """Replaces a `SerialChannel` if another sensor has the port,
    whose name is in the details of the port's state.
    """

    def __init__(self, owner: str, hears: socket.socket, motion: RobotMotion) -> None:
        self._owner = owner
        self._hears = hears
        self._motion = motion
        self._stop = threading.Event()
        self._line = LineState(
            PortState("away", Reason(ReasonCode.STARTING, "starting")), "ASCII", 0, {}
        )

    def line(self) -> LineState:
        """The owner's line, as far as known; for any thread."""
        port = self._line.port
        shared = replace(port, details={**port.details, "shared_by": self._owner})
        return msgspec.structs.replace(self._line, port=shared)

    def stop(self) -> None:
        self._stop.set()

    def run(self) -> None:
        self._hears.settimeout(_READ_S)
        heard_ns = time.monotonic_ns()
        while not self._stop.is_set():
            try:
                heard = _decoder.decode(self._hears.recv(_BYTES_MAX))
            except TimeoutError:
                if time.monotonic_ns() - heard_ns > SILENT_NS and self._line.port.state == "open":
                    reason = Reason(
                        ReasonCode.NO_ANSWER,
                        f"{self._owner}, which owns the port, is sending nothing",
                    )
                    self._line = msgspec.structs.replace(self._line, port=PortState("away", reason))
                continue
            if isinstance(heard, LineState):
                heard_ns, self._line = time.monotonic_ns(), heard
            else:
                self._motion.hear(heard)


class Robot(FrameObserver):
    """The robot's line, clock and poses; without a port, another sensor has it and shares it."""

    health_key = "serial"
    stop_s = SERIAL_STOPPED_S

    def __init__(
        self,
        port: SerialPort | None,
        on_request: Callable[[Request, Reply], None],
        state: Callable[[], dict[str, Any]],
        publish_status: Callable[[bytes], None],
        missing: Callable[[], Reason | None],
        quantities: Callable[[], Sequence[str] | Reason],
        shared: SharedLine | None = None,
    ) -> None:
        self._shared = shared
        self.motion = RobotMotion(shared.forward) if shared and shared.ends else RobotMotion()
        wake = port.wake if port else lambda: None
        self._touch = TouchEvents(port.baud if port else 0, wake)
        self.commands = SerialCommands(
            self.motion, on_request, state, missing, quantities, wake, self._touch
        )
        self._channel: SerialChannel | FollowingChannel
        if port:
            self._channel = SerialChannel(port, self.motion, self.commands)
        else:
            assert shared is not None
            assert shared.hears is not None
            self._channel = FollowingChannel(shared.owner, shared.hears, self.motion)
        self._publish_status = publish_status
        self._published = b""
        self._forwarded: LineState | None = None
        self._forwarded_ns = 0
        self._placed = PlacedFrames(self.commands.tell)
        self._stopped = threading.Event()
        self._with_pose = self._without_pose = 0
        # Two threads, `stitch` and `record`, ask for the same frame. `lru_cache` alone would let
        # both compute it at once, and later clock readings would place a press differently in
        # each.
        self._first_answer = threading.Lock()
        self._answer_at = lru_cache(_POSES_KEPT)(lambda t_ns: self.motion.at(t_ns))
        # A daemon thread: a port that hangs must not keep the process.
        self._thread = threading.Thread(target=self._channel.run, name="serial", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout_s: float) -> None:
        self._stopped.set()
        self._channel.stop()
        self._thread.join(timeout_s)

    def poll(self) -> None:
        """Publish ``status/serial`` if it has changed,
        and forward the line's state to those who share it.
        """
        line, sync, now_ns = self._channel.line(), self.motion.state(), time.monotonic_ns()
        if self._shared and self._shared.ends:
            before = self._forwarded
            changed = before is None or (line.port, line.mode) != (before.port, before.mode)
            # A change at once, its counts once a second.
            if changed or now_ns - self._forwarded_ns >= _LINE_PERIOD_NS:
                self._forwarded, self._forwarded_ns = line, now_ns
                self._shared.forward(line)
        port = line.port
        if port.state == "away":
            state, reason, details = "away", port.reason, port.details
        else:
            silent = now_ns - line.quiet_since_ns > SILENT_NS
            state = "silent" if silent else "connected"
            reason = sync.reason or self._placed.reason
            details = {**port.details, "mode": line.mode, "sync": sync.mode}
            # A port that is open but silent: the cable may end in nothing, or the robot does not
            # run.
            if silent:
                reason = Reason(
                    ReasonCode.STALLED, f"received nothing for more than {SILENT_NS / 1e9:.0f} s"
                )
            elif (
                reason is None
                and (latency_ms := int(port.details.get("latency_ms", 0))) > LATENCY_MAX_MS
            ):
                text = (
                    f"the port's chip holds bytes back for {latency_ms} ms; tacshade-edge doctor "
                    "explains the fix"
                )
                reason = Reason(ReasonCode.PORT_LATENCY, text)
        status = encode_status(state, reason, details)
        if status != self._published:
            self._published = status
            self._publish_status(status)

    def health(self) -> dict[str, Any]:
        frames = {"frames_with_pose": self._with_pose, "frames_without_pose": self._without_pose}
        return {
            **self._channel.line().counts,
            **self.motion.as_dict(),
            **frames,
            **self._touch.as_dict(),
        }

    def tell(self, event: str) -> None:
        """Send the robot an event; any thread may call it."""
        self.commands.tell(event)

    def need(self) -> Need:
        """Depth while a capture waits, and touches while the robot has switched them on."""
        depth = Need.DEPTH if self.commands.capture_pending else Need.CONTACT
        return depth | Need.TOUCH if self._touch.is_on else depth

    def see(self, seen: FrameResult) -> None:
        if seen.reconstruction is not None:
            self.commands.observe(seen.frame, seen.reconstruction)
            self._touch.observe(seen.reconstruction)
            self._placed.see(seen)

    def source_changed(self, source: SourceState) -> None:
        if source.reason:
            self._touch.lost()

    def with_interpolated_pose(self, frame: Frame) -> Frame:
        """Wait for the pose after the frame, and add the pose interpolated between it and the one
        before, if known. The first answer counts: later poses and clock readings would place a
        press in a session and in the recording differently.
        """
        self._stopped.wait(max(0, frame.t_ns + POSE_WAIT_NS - time.monotonic_ns()) / 1e9)
        with self._first_answer:
            known = self._answer_at(frame.t_ns)
        if known is None:  # `with_pose` may have known one before the robot restarted
            return replace(frame, pose=None, pose_error_us=0) if self._with_pose else frame
        return replace(frame, pose=known[0], pose_error_us=known[1])

    def knows_pose(self) -> bool:
        """Whether a frame taken now would get a pose, once the pose after it has come."""
        return self.motion.at(time.monotonic_ns() - POSE_WAIT_NS) is not None

    def with_pose(self, frame: Frame) -> Frame:
        """The frame with the pose that the sensor had, if known."""
        known = self.motion.at(frame.t_ns)
        if known is None:
            self._without_pose += 1
            return frame
        self._with_pose += 1
        return replace(frame, pose=known[0], pose_error_us=known[1])
