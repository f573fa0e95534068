"""The serial thread: opens the port, again and again, and carries bytes between it and the link."""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import dataclass, field
from typing import Any, Literal

from tacshade_edge.daemon.robot.motion import RobotMotion
from tacshade_edge.daemon.robot.serial_commands import SerialCommands
from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.errors import DeviceError
from tacshade_edge.protocol.serial_link import PROTOCOL_VERSION, Greeted, PoseArrived, SerialLink

_log = logging.getLogger(__name__)

FIRST_RETRY_S, LONGEST_RETRY_S = 0.1, 1.0
SILENT_NS = 3_000_000_000
GAP_PERIOD_NS, GAP_LOG_PERIOD_NS = 1_000_000_000, 60_000_000_000
NOT_READING_PAUSE_S = 1.0  # a robot that takes nothing is not waited for again and again


@dataclass(frozen=True, slots=True)
class PortState:
    """How the port is."""

    state: Literal["away", "open"]
    reason: str = ""
    details: dict[str, str | int | float] = field(default_factory=dict)


class SerialChannel:
    """One robot's line.

    Parameters
    ----------
    port : SerialPort
    motion : RobotMotion
    commands : SerialCommands

    Attributes
    ----------
    port_state : PortState
        Replaced as a whole; any thread may read it.
    quiet_since_ns : int
        When the latest byte came or the port was opened, CLOCK_MONOTONIC.
    """

    def __init__(self, port: SerialPort, motion: RobotMotion, commands: SerialCommands) -> None:
        self.port_state = PortState("away", "starting")
        self.quiet_since_ns = 0
        self._port = port
        self._link = SerialLink()
        self._motion = motion
        self._commands = commands
        self._stop = threading.Event()
        self._opened = 0
        self._lost_ns: int | None = None
        self._away_ms = 0
        self._unsent_bytes = 0
        self._deaf_until_s = 0.0
        self._gap, self._gap_told_ns, self._gap_logged_ns = 0, 0, 0
        self._told_sync = "none"

    @property
    def mode(self) -> str:
        """``ASCII`` or ``BIN``."""
        return self._link.mode

    def stop(self) -> None:
        """Make `run` return soon."""
        self._stop.set()
        self._port.wake()

    def run(self) -> None:
        """Serve the robot until `stop`; a lost port is opened again with growing pauses."""
        retry_s = FIRST_RETRY_S
        while not self._stop.is_set():
            try:
                self._port.open()
                self._say_ready()
                while not self._stop.is_set():
                    if self._turn():
                        retry_s = FIRST_RETRY_S
            except DeviceError as error:
                self._tell(PortState("away", str(error)))
                if self._lost_ns is None and self._opened:
                    self._lost_ns = time.monotonic_ns()
            finally:
                self._port.close()
                self._link.interrupted()
            self._stop.wait(retry_s)
            retry_s = min(2 * retry_s, LONGEST_RETRY_S)

    def as_dict(self) -> dict[str, Any]:
        """For ``health``."""
        return {
            **self._link.counts.as_dict(),
            "reopened": max(0, self._opened - 1),
            "away_ms": self._away_ms,
            "unsent_bytes": self._unsent_bytes,
        }

    def _say_ready(self) -> None:
        """A session outlives its port, and the robot is told how long it was away."""
        self._opened += 1
        self.quiet_since_ns = time.monotonic_ns()
        away_ms = 0
        if self._lost_ns is not None:
            away_ms = (self.quiet_since_ns - self._lost_ns) // 1_000_000
            self._away_ms += away_ms
            self._lost_ns = None
        self._tell(PortState("open", "", self._port.describe()))
        gap = f" away_ms={away_ms}" if away_ms else ""
        self._link.event(f"READY tacshade {PROTOCOL_VERSION}{gap}")

    def _turn(self) -> bool:
        """One wait for bytes, and all that they cause; whether some came."""
        data = self._port.read()
        now_ns = time.monotonic_ns()
        if data:
            self.quiet_since_ns = now_ns
        for event in self._link.receive(data, now_ns):
            if isinstance(event, PoseArrived):
                self._gap += event.lost
                self._motion.add(event)
            elif isinstance(event, Greeted):
                _log.info("the robot greeted%s", f", boot {event.boot}" if event.boot else "")
                self._motion.began_anew()
            else:
                self._commands.handle(event, self._link)
        self._commands.send_answers(self._link)
        self._say_news(now_ns)
        self._write()
        return bool(data)

    def _say_news(self, now_ns: int) -> None:
        if self._gap and now_ns - self._gap_told_ns >= GAP_PERIOD_NS:
            self._link.event(f"GAP poses={self._gap}")
            if now_ns - self._gap_logged_ns >= GAP_LOG_PERIOD_NS:
                self._gap_logged_ns = now_ns
                _log.info("%d poses are missing by their numbers so far", self._link.counts.poses_lost)
            self._gap, self._gap_told_ns = 0, now_ns
        sync = self._motion.state()
        if sync.mode != self._told_sync:
            self._told_sync = sync.mode
            self._link.event(f"SYNC mode={sync.mode} error_us={sync.error_us}")
            _log.info("sync %s%s", sync.mode, f": {sync.reason}" if sync.reason else "")

    def _write(self) -> None:
        data = self._link.take_output()
        if not data:
            return
        if time.monotonic() < self._deaf_until_s:
            self._unsent_bytes += len(data)
        elif not self._port.write(data):
            # Some of it may be out; the robot's parser drops what is cut, and asks again.
            self._unsent_bytes += len(data)
            self._deaf_until_s = time.monotonic() + NOT_READING_PAUSE_S

    def _tell(self, state: PortState) -> None:
        if state != self.port_state:
            self.port_state = state
            _log.info("serial %s%s", state.state, f": {state.reason}" if state.reason else "")
