"""The robot next to the sensor: the part of the daemon that exists only with ``serial`` in the settings.

Several sensors' processes may share a robot's line: one has the port, answers commands, and forwards what it hears, so
that all have the same clock and poses. Each follower has its own pair of datagram sockets; a pose that finds no room is
lost to it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

from tacshade_edge.daemon.observer import SERIAL_STOPPED_S, FrameObserver, FrameResult
from tacshade_edge.daemon.serial_line import SILENT_NS, RobotMotion, SerialChannel, SerialCommands, TouchEvents
from tacshade_edge.daemon.shared_line import FollowingChannel, ForwardingMotion, SharedLine
from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.protocol.messages import encode_status
from tacshade_edge.protocol.requests import Request
from tacshade_edge.protocol.results import RequestResult
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Frame, Need

# How long a frame waits for the pose after it: enough if the robot sends ten a second.
POSE_WAIT_NS = 120_000_000
_POSES_KEPT: Final = 1024
LATENCY_MAX_MS = 1


class Robot(FrameObserver):
    """The robot's line, clock and poses; without a port, another sensor has it and shares it."""

    health_key = "serial"
    stop_s = SERIAL_STOPPED_S

    def __init__(
        self,
        port: SerialPort | None,
        on_request: Callable[[Request], None],
        state: Callable[[], dict[str, Any]],
        publish_status: Callable[[bytes], None],
        missing: Callable[[], Reason | None],
        shared: SharedLine | None = None,
    ) -> None:
        self.motion = ForwardingMotion(shared.ends) if shared and shared.ends else RobotMotion()
        wake = port.wake if port else lambda: None
        self._touch = TouchEvents(port.baud if port else 0, wake)
        self.commands = SerialCommands(self.motion, on_request, state, missing, wake, self._touch)
        self._channel: SerialChannel | FollowingChannel
        if port:
            self._channel = SerialChannel(port, self.motion, self.commands)
        else:
            assert shared is not None
            assert shared.hears is not None
            self._channel = FollowingChannel(shared.owner, shared.hears, self.motion)
        self._publish_status = publish_status
        self._published = b""
        self._stopped = threading.Event()
        self._with_pose = self._without_pose = 0
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
        port, sync = self._channel.port_state, self.motion.state()
        if isinstance(self.motion, ForwardingMotion):
            quiet_since_ns, counts = self._channel.quiet_since_ns, self._channel.as_dict()
            self.motion.forward_port(port, self._channel.mode, quiet_since_ns, counts)
        if port.state == "away":
            state, reason, details = "away", port.reason, port.details
        else:
            silent = time.monotonic_ns() - self._channel.quiet_since_ns > SILENT_NS
            state, reason = "silent" if silent else "connected", sync.reason
            details = {**port.details, "mode": self._channel.mode, "sync": sync.mode}
            if silent:
                reason = Reason(ReasonCode.STALLED, f"received nothing for more than {SILENT_NS / 1e9:.0f} s")
            elif reason is None and (latency_ms := int(port.details.get("latency_ms", 0))) > LATENCY_MAX_MS:
                text = f"the port's chip holds bytes back for {latency_ms} ms; tacshade-edge doctor explains the fix"
                reason = Reason(ReasonCode.PORT_LATENCY, text)
        status = encode_status(state, reason, details)
        if status != self._published:
            self._published = status
            self._publish_status(status)

    def health(self) -> dict[str, Any]:
        frames = {"frames_with_pose": self._with_pose, "frames_without_pose": self._without_pose}
        return {**self._channel.as_dict(), **self.motion.as_dict(), **frames, **self._touch.as_dict()}

    def need(self) -> Need:
        """Depth while a capture waits, and touches while the robot has switched them on."""
        depth = Need.DEPTH if self.commands.capture_pending else Need.CONTACT
        return depth | Need.TOUCH if self._touch.is_on else depth

    def see(self, seen: FrameResult) -> None:
        if seen.reconstruction is not None:
            self.commands.observe(seen.frame, seen.reconstruction)
            self._touch.observe(seen.reconstruction)

    def answer(self, request: Request, outcome: RequestResult | Mapping[str, Any] | Reason) -> bool:
        return self.commands.complete(request, outcome)

    def with_interpolated_pose(self, frame: Frame) -> Frame:
        """Wait for the pose after the frame, and add the pose interpolated between it and the one before, if known. The
        first answer counts: later poses and clock readings would place a press in a session and in the recording
        differently.
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
