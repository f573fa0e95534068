"""The robot's line: the serial thread opens its port, reopens a lost one, and carries bytes between
it, the link and the commands.
"""

from __future__ import annotations

import logging
import threading
import time
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import msgspec

from tacshade_edge.errors import DeviceError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.framing import Mode
from tacshade_edge.robot.line import LINE_BYTES_MAX
from tacshade_edge.robot.port import SerialPort
from tacshade_edge.robot.robot_motion import PoseHeard, RobotMotion, RobotRestarted
from tacshade_edge.robot.serial_commands import SerialCommands
from tacshade_edge.robot.serial_link import Greeted, PoseArrived, SerialLink
from tacshade_edge.robot.verbs import rate_text, ready_text

_log = logging.getLogger(__name__)

# A cable that is put back works again at once; one that is away costs one try a second.
FIRST_RETRY_S, LONGEST_RETRY_S = 0.1, 1.0
# The robot learns of lost poses within a second. The log, which a bad cable would fill for days,
# has the sum once a minute.
GAP_PERIOD_NS, GAP_LOG_PERIOD_NS = 1_000_000_000, 60_000_000_000
# A robot that does not read gets nothing for this long: each try to write costs `WRITE_S`, in which
# no pose is read.
NOT_READING_PAUSE_S = 1.0


@dataclass(frozen=True, slots=True)
class PortState:
    state: Literal["away", "open"]
    reason: Reason | None = None
    details: dict[str, str | int | float] = field(default_factory=dict)


class LineState(msgspec.Struct, frozen=True, tag=4, array_like=True):
    """A line's port, and since when it is quiet: since the latest byte,
    or since the port was opened.
    """

    port: PortState
    mode: Mode
    quiet_since_ns: int
    counts: dict[str, Any]


class SerialChannel:
    """One robot's line: opens the port, reopens it when lost,
    and carries bytes between it and the link.
    """

    def __init__(self, port: SerialPort, motion: RobotMotion, commands: SerialCommands) -> None:
        self._port_state = PortState("away", Reason(ReasonCode.STARTING, "starting"))
        self._quiet_since_ns = 0
        self._port = port
        self._link = SerialLink()
        self._motion = motion
        self._commands = commands
        self._stop = threading.Event()
        self._opened = 0
        self._lost_ns: int | None = None
        self._away_ms = 0
        self._unsent_bytes = 0
        self._write_after_s = 0.0
        self._missing, self._gap_sent_ns, self._gap_logged_ns = 0, 0, 0
        self._sent_sync, self._sent_rate = "none", ""

    def line(self) -> LineState:
        """The line now; for any thread."""
        counts = {
            **asdict(self._link.counts),
            "reopened": max(0, self._opened - 1),
            "away_ms": self._away_ms,
            "unsent_bytes": self._unsent_bytes,
        }
        return LineState(self._port_state, self._link.mode, self._quiet_since_ns, counts)

    def stop(self) -> None:
        self._stop.set()
        self._port.wake()

    def run(self) -> None:
        """Serve the robot until `stop`, then answer all that it has asked; reopen a lost port with
        growing pauses.
        """
        retry_s = FIRST_RETRY_S
        while not self._stop.is_set():
            try:
                self._port.open()
                self._on_open()
                while not self._stop.is_set():
                    # Only bytes prove that a port works: one that opens and fails at once keeps
                    # its growing pauses.
                    if self._turn():
                        retry_s = FIRST_RETRY_S
                self._commands.send_last_answers(self._link)
                self._write()
            except DeviceError as error:
                self._set_state(PortState("away", error.reason))
                # The first failure after an opening is the loss; those that follow are tries to
                # open again.
                if self._lost_ns is None and self._opened:
                    self._lost_ns = time.monotonic_ns()
            finally:
                self._port.close()
                self._link.interrupted()
            self._stop.wait(retry_s)
            retry_s = min(2 * retry_s, LONGEST_RETRY_S)

    def _on_open(self) -> None:
        """Report to the robot how long the port was away: a session outlives its port."""
        self._opened += 1
        self._quiet_since_ns = time.monotonic_ns()
        away_ms = 0
        if self._lost_ns is not None:
            away_ms = (self._quiet_since_ns - self._lost_ns) // 1_000_000
            self._away_ms += away_ms
            self._lost_ns = None
        self._set_state(PortState("open", None, self._port.describe()))
        self._link.notify(ready_text(away_ms))

    def _turn(self) -> bool:
        """Wait once for bytes and handle all that they cause; return whether some came."""
        data = self._port.read()
        now_ns = time.monotonic_ns()
        if data:
            self._quiet_since_ns = now_ns
        for received in self._link.receive(data, now_ns):
            if isinstance(received, PoseArrived):
                self._missing += received.missing
                self._motion.hear(PoseHeard(received.sample, received.arrived_ns))
            elif isinstance(received, Greeted):
                _log.info(
                    "the robot sent a greeting%s",
                    f", boot {received.boot}" if received.boot else "",
                )
                self._motion.hear(RobotRestarted())
                self._commands.touch.switch(None)
            else:
                self._commands.handle(received, self._link)
        # Answers before events, and a touch last: it waits for a port that is almost free, so
        # that the newest one goes out.
        self._commands.send_answers(self._link)
        self._send_events(now_ns)
        self._send_touch()
        self._write()
        return bool(data)

    def _send_events(self, now_ns: int) -> None:
        if self._missing and now_ns - self._gap_sent_ns >= GAP_PERIOD_NS:
            self._link.notify(f"GAP poses={self._missing}")
            if now_ns - self._gap_logged_ns >= GAP_LOG_PERIOD_NS:
                self._gap_logged_ns = now_ns
                _log.info(
                    "lost %d poses so far, judging by gaps in the sequence numbers",
                    self._link.counts.poses_lost,
                )
            self._missing, self._gap_sent_ns = 0, now_ns
        sync = self._motion.state()
        rate = "" if sync.suspected is None else rate_text(sync.suspected)
        if rate != self._sent_rate:
            self._sent_rate = rate
            if sync.suspected is not None:
                self._link.notify(rate)
                _log.warning("%s", sync.suspected)
        if sync.mode != self._sent_sync:
            self._sent_sync = sync.mode
            self._link.notify(f"SYNC mode={sync.mode} error_us={sync.error_us}")
            _log.info("sync %s%s", sync.mode, f": {sync.reason}" if sync.reason else "")

    def _send_touch(self) -> None:
        """Pass the newest touch to a port with less than a line to send,
        so that the port sends the newest.
        """
        if time.monotonic() < self._write_after_s or self._port.unsent() >= LINE_BYTES_MAX:
            return
        if (seen := self._commands.touch.take()) is not None:
            self._link.notify(seen.text())

    def _write(self) -> None:
        data = self._link.take_output()
        if not data:
            return
        if time.monotonic() < self._write_after_s:
            self._unsent_bytes += len(data)
        elif not self._port.write(data):
            # Some of it may be sent; the robot's parser drops the cut line,
            # and the robot repeats the command.
            self._unsent_bytes += len(data)
            self._write_after_s = time.monotonic() + NOT_READING_PAUSE_S

    def _set_state(self, state: PortState) -> None:
        if state != self._port_state:
            self._port_state = state
            _log.info("serial %s%s", state.state, f": {state.reason}" if state.reason else "")
