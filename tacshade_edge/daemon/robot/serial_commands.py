"""Carries out the robot's commands. They arrive in the serial thread; any thread answers them through a queue."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from queue import Empty, SimpleQueue
from typing import Any, Protocol

from tacshade_edge.daemon.robot.motion import RobotMotion
from tacshade_edge.daemon.robot.touch_events import TouchEvents
from tacshade_edge.protocol.requests import Request
from tacshade_edge.protocol.results import (
    ClockRead,
    FrameCaptured,
    LineStatus,
    ReferenceTaken,
    RequestResult,
    SerialResult,
    SessionResult,
)
from tacshade_edge.protocol.serial.commands import Command, parse_touch
from tacshade_edge.protocol.serial.link import SerialLink
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Frame, Reconstruction

CAPTURE_TIMEOUT_NS = 5_000_000_000
WAITING_MAX = 16


class Sessions(Protocol):
    """Stitching sessions, for the verbs STITCH BEGIN, ADD, END, ABORT and STATUS."""

    def submit(self, action: str, name: str, reply: Callable[[SessionResult | Reason], None]) -> None:
        """Do `action` (``BEGIN`` ...) without waiting; `name` is empty if none was given.

        `reply` is called once, now or later, from any thread, with the result or the reason that there is none.
        """
        ...


class SerialCommands:
    """Carries out each command once and answers it once.

    Parameters
    ----------
    motion : RobotMotion
    on_request : callable
        Passes a `Request` to the main thread, as for MQTT; `complete` receives its outcome.
    state : callable
        Returns the daemon's state, as for ``req/status``.
    missing : callable
        Returns why there is no calibration; None if there is one.
    wake : callable
        Called when an answer waits to be sent.
    touch : TouchEvents

    Attributes
    ----------
    sessions : Sessions or None
        With None the answer is ``UNAVAILABLE``.
    """

    def __init__(
        self,
        motion: RobotMotion,
        on_request: Callable[[Request], None],
        state: Callable[[], dict[str, Any]],
        missing: Callable[[], Reason | None],
        wake: Callable[[], None],
        touch: TouchEvents,
    ) -> None:
        self.sessions: Sessions | None = None
        self.touch = touch
        self._motion = motion
        self._on_request = on_request
        self._state = state
        self._missing = missing
        self._wake = wake
        self._answers: SimpleQueue[tuple[Command, SerialResult | Reason]] = SimpleQueue()
        self._lock = threading.Lock()
        self._captures: list[Command] = []
        self._requests: list[tuple[Request, Command]] = []

    def handle(self, command: Command, link: SerialLink) -> None:
        """Start a command; called in the serial thread."""
        if command.verb == "SYNC":
            t1_ns, *rest = map(int, command.args)
            self._motion.sync_received(t1_ns, command.arrived_ns, rest[0] if rest else None)
            t3_ns = time.monotonic_ns()
            link.answer(command, ClockRead(command.arrived_ns, t3_ns))
            self._motion.sync_answered(t3_ns)
        elif command.verb == "STATUS":
            link.answer(command, self._status(link))
        elif (missing := self._missing()) is not None:
            link.answer(command, missing)
        elif command.verb == "TOUCH":
            link.answer(command, self.touch.switch(parse_touch(command.args)))
        elif command.verb == "CAPTURE":
            with self._lock:
                busy = len(self._captures) >= WAITING_MAX
                if not busy:
                    self._captures.append(command)
            if busy:
                link.answer(command, Reason(ReasonCode.BUSY, f"{WAITING_MAX} captures are already waiting"))
        elif command.verb == "REFERENCE":
            request = Request("reference")
            with self._lock:
                self._requests.append((request, command))
            self._on_request(request)
        elif self.sessions is None:
            link.answer(command, Reason(ReasonCode.UNAVAILABLE, "this daemon is not ready to stitch"))
        else:
            action, *name = command.args
            self.sessions.submit(action, name[0] if name else "", lambda outcome: self._answer(command, outcome))

    def send_answers(self, link: SerialLink) -> None:
        """Give the link the answers since the last call; called in the serial thread."""
        now_ns = time.monotonic_ns()
        with self._lock:
            late = [c for c in self._captures if now_ns - c.arrived_ns > CAPTURE_TIMEOUT_NS]
            self._captures = [c for c in self._captures if c not in late]
        for command in late:
            link.answer(command, Reason(ReasonCode.TIMEOUT, f"no frame within {CAPTURE_TIMEOUT_NS / 1e9:.0f} s"))
        while True:
            try:
                command, outcome = self._answers.get_nowait()
            except Empty:
                return
            link.answer(command, outcome)

    @property
    def capture_pending(self) -> bool:
        """Whether a CAPTURE waits for the next reconstruction."""
        return bool(self._captures)

    def observe(self, frame: Frame, result: Reconstruction) -> None:
        """Answer the captures that arrived before this frame was taken."""
        if not self._captures:
            return
        with self._lock:
            ready = [c for c in self._captures if c.arrived_ns <= frame.t_ns]
            self._captures = [c for c in self._captures if c not in ready]
        for command in ready:
            self._answer(command, _captured(frame, result))

    def complete(self, request: Request, outcome: RequestResult | Mapping[str, Any] | Reason) -> bool:
        """Take the main thread's outcome of a request; True if the robot made the request."""
        with self._lock:
            command = next((c for r, c in self._requests if r is request), None)
            self._requests = [(r, c) for r, c in self._requests if r is not request]
        if command is None:
            return False
        if not isinstance(outcome, ReferenceTaken | Reason):
            raise TypeError(f"found {type(outcome).__name__} as the outcome of a reference")
        self._answer(command, outcome)
        return True

    def _answer(self, command: Command, outcome: SerialResult | Reason) -> None:
        self._answers.put((command, outcome))
        self._wake()

    def _status(self, link: SerialLink) -> LineStatus:
        state, sync, counts = self._state(), self._motion.state(), link.counts
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
        depth_mm=result.depth_max_mm,
        area_mm2=sum(o.area_mm2 for o in result.objects),
        objects=len(result.objects),
        pose_error_us=None if frame.pose is None else frame.pose_error_us,
    )
