"""The robot's line: its clock and poses, its commands, and the serial thread,
which carries their bytes.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, Literal

import msgspec

from tacshade_edge.errors import DeviceError
from tacshade_edge.pipeline.observer import FrameWaiters, Reply
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.clock_sync import ClockSync, SyncState
from tacshade_edge.robot.framing import Mode
from tacshade_edge.robot.line import LINE_BYTES_MAX
from tacshade_edge.robot.port import SerialPort
from tacshade_edge.robot.pose import PoseSample
from tacshade_edge.robot.pose_buffer import PoseBuffer
from tacshade_edge.robot.serial_link import Greeted, PoseArrived, SerialLink
from tacshade_edge.robot.verbs import (
    Command,
    TouchAsked,
    TouchSeen,
    parse_touch,
    ready_text,
    too_slow,
)
from tacshade_edge.types import Frame, Pose, Reconstruction
from tacshade_edge.wire.requests import Request
from tacshade_edge.wire.results import (
    ClockRead,
    FrameCaptured,
    LineStatus,
    SerialResult,
    TouchSwitched,
)


class PoseHeard(msgspec.Struct, frozen=True, tag=1, array_like=True):
    """A pose from the robot, and when it arrived."""

    sample: PoseSample
    arrived_ns: int


class ClockExchanged(msgspec.Struct, frozen=True, tag=2, array_like=True):
    """A ``SYNC`` and its reply: when the robot sent it, it arrived,
    the reply and the previous reply arrived.
    """

    t1_ns: int
    t2_ns: int
    t3_ns: int
    t4_ns: int | None


class RobotRestarted(msgspec.Struct, frozen=True, tag=3, array_like=True):
    """The robot sent its greeting, so it has another clock."""


Heard = PoseHeard | ClockExchanged | RobotRestarted


class RobotMotion:
    """Where the sensor was and when, from what was `Heard` of the robot; `forward` passes that on
    to other sensors. Any thread may use it.
    """

    def __init__(self, forward: Callable[[Heard], None] = lambda heard: None) -> None:
        self._forward = forward
        self._lock = threading.Lock()
        self._sync = ClockSync()
        self._poses = PoseBuffer()
        self._restarts = 0

    def hear(self, heard: Heard) -> None:
        with self._lock:
            if isinstance(heard, PoseHeard):
                self._sync.stamp_received(heard.sample.t_ns, heard.arrived_ns)
            elif isinstance(heard, ClockExchanged):
                self._sync.sync_received(heard.t1_ns, heard.t2_ns, heard.t4_ns)
                self._sync.sync_answered(heard.t3_ns)
            else:
                self._sync.restart(Reason(ReasonCode.ROBOT_RESTARTED, "the robot restarted"))
            if self._restarts != self._sync.counts.restarts:  # the poses are of an earlier clock
                self._restarts = self._sync.counts.restarts
                self._poses.clear()
            if isinstance(heard, PoseHeard):
                self._poses.add(Pose(heard.sample.t_ns, *heard.sample.values))
        self._forward(heard)

    def at(self, t_ns: int) -> tuple[Pose, int] | None:
        """``base_T_flange`` at a time of CLOCK_MONOTONIC, and its greatest time error in µs;
        None if unknown.
        """
        with self._lock:
            robot = self._sync.to_robot(t_ns)
            sample = None if robot is None else self._poses.at(robot.t_ns)
        if robot is None or sample is None:
            return None
        return replace(sample.pose, t_ns=t_ns), -(
            -(robot.error_ns + sample.extrapolated_ns) // 1000
        )

    def state(self) -> SyncState:
        with self._lock:
            return self._sync.state()

    def as_dict(self) -> dict[str, Any]:
        with self._lock:
            state, counts, late = self._sync.state(), self._sync.counts, self._poses.late
            return {
                "sync": state.mode,
                "offset_ns": state.offset_ns,
                "drift_ppm": state.drift_ppm,
                "error_us": state.error_us,
                "exchanges": counts.exchanges,
                "exchanges_refused": counts.exchanges_refused,
                "exchange_outliers": counts.outliers,
                "clock_restarts": counts.restarts,
                "poses_late": late,
            }


_JITTER = 0.25  # of a period: a frame that is this much early counts as on time


class TouchEvents:
    """What ``TOUCH ON`` requested, and the newest touch:
    it replaces one that the port has not taken yet.
    """

    def __init__(self, baud: int, wake: Callable[[], None]) -> None:
        self._baud = baud
        self._wake = wake
        self._lock = threading.Lock()
        self._asked: TouchAsked | None = None
        self._waiting: TouchSeen | None = None
        self._touches = False
        self._due_ns = 0
        self._events = self._dropped = 0

    @property
    def is_on(self) -> bool:
        return self._asked is not None

    def switch(self, asked: TouchAsked | None) -> TouchSwitched | Reason:
        """Start what was requested, or stop; if the line is too slow, change nothing."""
        if asked is not None and (reason := too_slow(asked, self._baud)) is not None:
            return reason
        with self._lock:
            self._asked, self._waiting, self._touches, self._due_ns = asked, None, False, 0
        return TouchSwitched(asked.rate_hz if asked else 0)

    def observe(self, result: Reconstruction) -> None:
        """Keep a frame's touch for the port if it is due; an invalid frame changes nothing."""
        if self._asked is None or not result.valid:
            return
        with self._lock:
            if (seen := self._due(self._asked, result)) is None:
                return
            self._dropped += self._waiting is not None
            self._waiting = seen
        self._wake()

    def take(self) -> TouchSeen | None:
        with self._lock:
            seen, self._waiting = self._waiting, None
            self._events += seen is not None
        return seen

    def as_dict(self) -> dict[str, int]:
        return {"touch_events": self._events, "touch_dropped": self._dropped}

    def _due(self, asked: TouchAsked | None, result: Reconstruction) -> TouchSeen | None:
        if asked is None:
            return None
        if result.touch is None and not result.touched:
            if result.contact:
                return None  # the frame was begun before the request
            ended, self._touches = self._touches, False
            return (
                TouchSeen(result.seq, result.t_ns, False, tuple((n, None) for n in asked.names))
                if ended
                else None
            )
        self._touches = True
        period_ns = 1_000_000_000 // asked.rate_hz
        if result.t_ns < self._due_ns - _JITTER * period_ns:
            return None
        on_time = result.t_ns - self._due_ns < period_ns
        self._due_ns = (self._due_ns if on_time else result.t_ns) + period_ns
        values = {} if result.touch is None else result.touch.values
        numbers = tuple((n, values.get(n)) for n in asked.names)
        return TouchSeen(result.seq, result.t_ns, result.contact, numbers, result.touched)


TOLD_MAX = 16


@dataclass(slots=True, eq=False)
class SerialCommands:
    """Carries out each command once and answers it once;
    they arrive in the serial thread, any thread answers them.
    """

    motion: RobotMotion
    on_request: Callable[[Request, Reply], None]  # starts what the main thread does
    state: Callable[[], dict[str, Any]]
    missing: Callable[[], Reason | None]
    wake: Callable[[], None]  # called when an answer waits to be sent
    touch: TouchEvents
    stitch: Callable[[str, str, Reply], None] | None = (
        None  # BEGIN, ADD, END, ABORT or STATUS, and a name
    )
    _answers: SimpleQueue[tuple[Command, SerialResult | Reason]] = field(
        default_factory=SimpleQueue
    )
    _told: deque[str] = field(default_factory=partial(deque, maxlen=TOLD_MAX))
    _captures: FrameWaiters = field(
        default_factory=partial(FrameWaiters, "captures are already waiting")
    )

    def handle(self, command: Command, link: SerialLink) -> None:
        """Start a command; called in the serial thread."""
        if command.verb == "SYNC":
            t1_ns, *rest = map(int, command.args)
            t3_ns = time.monotonic_ns()
            link.answer(command, ClockRead(command.arrived_ns, t3_ns))
            self.motion.hear(
                ClockExchanged(t1_ns, command.arrived_ns, t3_ns, rest[0] if rest else None)
            )
        elif command.verb == "STATUS":
            link.answer(command, self._status(link))
        elif (missing := self.missing()) is not None:
            link.answer(command, missing)
        elif command.verb == "TOUCH":
            link.answer(command, self.touch.switch(parse_touch(command.args)))
        elif command.verb == "CAPTURE":
            self._captures.put(command.arrived_ns, partial(self._answer, command))
        elif command.verb == "REFERENCE":
            self.on_request(Request("reference"), partial(self._answer, command))
        elif command.verb == "STITCH" and self.stitch is not None:
            action, *name = command.args
            self.stitch(action, name[0] if name else "", partial(self._answer, command))
        else:
            text = f"this daemon is not ready to {command.verb.lower()}"
            link.answer(command, Reason(ReasonCode.UNAVAILABLE, text))

    def tell(self, event: str) -> None:
        """Send an event to the robot; with `TOLD_MAX` waiting, the oldest is dropped."""
        self._told.append(event)
        self.wake()

    def send_answers(self, link: SerialLink) -> None:
        """Give the link the answers and events since the last call; called in the serial thread."""
        while self._told:
            link.notify(self._told.popleft())
        self._captures.expire(time.monotonic_ns())
        while True:
            try:
                command, outcome = self._answers.get_nowait()
            except Empty:
                return
            link.answer(command, outcome)

    @property
    def capture_pending(self) -> bool:
        return len(self._captures) > 0

    def observe(self, frame: Frame, result: Reconstruction) -> None:
        """Answer the captures that arrived before this frame was taken."""
        for answer in self._captures.take(frame.t_ns):
            answer(_captured(frame, result))

    def _answer(self, command: Command, outcome: SerialResult | Reason) -> None:
        self._answers.put((command, outcome))
        self.wake()

    def _status(self, link: SerialLink) -> LineStatus:
        state, sync, counts = self.state(), self.motion.state(), link.counts
        return LineStatus(
            camera=state["source"],
            fps=state["health"].get("delivered_fps", 0),
            sync=sync.mode,
            error_us=sync.error_us,
            drift_ppm=sync.drift_ppm,
            poses=counts.poses,
            lost=counts.poses_lost,
            damaged=counts.damaged,
            garbage=counts.garbage,
        )


def _captured(frame: Frame, result: Reconstruction) -> FrameCaptured | Reason:
    if not result.valid:
        return Reason(ReasonCode.FRAME_INVALID, f"frame={result.seq}: {result.reason}")
    return FrameCaptured(
        frame=result.seq,
        t_ns=result.t_ns,
        contact=result.contact,
        depth_mm=None if result.touched else result.depth_max_mm,
        area_mm2=None if result.touched else sum(o.area_mm2 for o in result.objects),
        objects=len(result.objects),
        pose_error_us=None if frame.pose is None else frame.pose_error_us,
        touched=result.touched,
    )


_log = logging.getLogger(__name__)

FIRST_RETRY_S, LONGEST_RETRY_S = 0.1, 1.0
GAP_PERIOD_NS, GAP_LOG_PERIOD_NS = 1_000_000_000, 60_000_000_000
NOT_READING_PAUSE_S = 1.0  # a robot that does not read gets nothing for this long


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
        self._sent_sync = "none"

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
        """Serve the robot until `stop`; reopen a lost port with growing pauses."""
        retry_s = FIRST_RETRY_S
        while not self._stop.is_set():
            try:
                self._port.open()
                self._on_open()
                while not self._stop.is_set():
                    if self._turn():
                        retry_s = FIRST_RETRY_S
            except DeviceError as error:
                self._set_state(PortState("away", error.reason))
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
