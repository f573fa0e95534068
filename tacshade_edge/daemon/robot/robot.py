"""The robot beside the sensor: all of the daemon that is there only with ``serial`` in the settings."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from tacshade_edge.daemon.pipeline.ledger import FrameOutcome
from tacshade_edge.daemon.pipeline.workers import Sink
from tacshade_edge.daemon.robot.motion import RobotMotion
from tacshade_edge.daemon.robot.serial_channel import SILENT_NS, SerialChannel
from tacshade_edge.daemon.robot.serial_commands import SerialCommands
from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.protocol.messages import Request, encode_status
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Calibration, Frame, Reconstruction

# A recorded frame waits so long for the pose after it: that of a robot that tells ten a second is there then.
SETTLED_NS = 120_000_000
LATENCY_MAX_MS = 1


class Robot:
    """Its line, its clock and its poses.

    Parameters
    ----------
    port : SerialPort
    on_request : callable
        Takes the robot's requests for the main thread.
    state : callable
        The daemon's state, as for ``req/status``.
    tell : callable
        ``tell(payload)`` publishes ``status/serial``.

    Attributes
    ----------
    motion : RobotMotion
    commands : SerialCommands
    """

    def __init__(
        self,
        port: SerialPort,
        on_request: Callable[[Request], None],
        state: Callable[[], dict[str, Any]],
        tell: Callable[[bytes], None],
    ) -> None:
        self.motion = RobotMotion()
        self.commands = SerialCommands(self.motion, on_request, state, port.wake)
        self._channel = SerialChannel(port, self.motion, self.commands)
        self._tell = tell
        self._told = b""
        self._stopped = threading.Event()
        self._posed = self._unposed = 0
        # A daemon thread: a port that hangs must not keep the process.
        self._thread = threading.Thread(target=self._channel.run, name="serial", daemon=True)

    def start(self) -> None:
        """Begin to serve the line."""
        self._thread.start()

    def stop(self, timeout_s: float) -> None:
        """Let go of the line."""
        self._stopped.set()
        self._channel.stop()
        self._thread.join(timeout_s)

    def poll(self) -> None:
        """Tell ``status/serial`` when it changed; called in the main thread."""
        port, sync = self._channel.port_state, self.motion.state()
        if port.state == "away":
            status = encode_status("away", Reason(ReasonCode.DEVICE, port.reason), port.details)
        else:
            silent = time.monotonic_ns() - self._channel.quiet_since_ns > SILENT_NS
            reason = f"nothing for more than {SILENT_NS / 1e9:.0f} s" if silent else sync.reason
            if not reason and int(port.details.get("latency_ms", 0)) > LATENCY_MAX_MS:
                reason = f"the port's chip holds bytes back for {port.details['latency_ms']} ms; doctor tells the mend"
            details = {**port.details, "mode": self._channel.mode, "sync": sync.mode}
            why = Reason(ReasonCode.STALLED if silent else ReasonCode.DEVICE, reason) if reason else None
            status = encode_status("silent" if silent else "connected", why, details)
        if status != self._told:
            self._told = status
            self._tell(status)

    def as_dict(self) -> dict[str, Any]:
        """For ``health``."""
        frames = {"frames_with_pose": self._posed, "frames_without_pose": self._unposed}
        return {**self._channel.as_dict(), **self.motion.as_dict(), **frames}

    def posed(self, sink: Sink) -> Sink:
        """`sink`, whose frames get their poses, and whose results answer the robot's captures."""
        return _PosedSink(sink, self)

    def with_settled_pose(self, frame: Frame) -> Frame:
        """The frame with the pose between the two about it, for which it waits; for a recording."""
        self._stopped.wait(max(0, frame.t_ns + SETTLED_NS - time.monotonic_ns()) / 1e9)
        found = self.motion.at(frame.t_ns)
        return frame if found is None else replace(frame, pose=found[0], pose_error_us=found[1])

    def knows_pose(self) -> bool:
        """Whether a frame of now would get one, once the pose after it is there."""
        return self.motion.at(time.monotonic_ns() - SETTLED_NS) is not None

    def with_pose(self, frame: Frame) -> Frame:
        """The frame with the pose that the sensor had."""
        found = self.motion.at(frame.t_ns)
        if found is None:
            self._unposed += 1
            return frame
        self._posed += 1
        return replace(frame, pose=found[0], pose_error_us=found[1])


class _PosedSink:
    def __init__(self, sink: Sink, robot: Robot) -> None:
        self._sink = sink
        self._robot = robot

    def needs_depth(self) -> bool:
        return self._robot.commands.waits_for_a_frame or self._sink.needs_depth()

    def deliver(self, frame: Frame, result: Reconstruction | None, calibration: Calibration) -> FrameOutcome | None:
        posed = self._robot.with_pose(frame)
        outcome = self._sink.deliver(posed, result, calibration)
        if result is not None:
            self._robot.commands.reconstructed(posed, result)
        return outcome
