"""The robot's commands on their way from the serial thread to whoever carries them out,
and their answers on the way back.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

from tacshade_edge.pipeline.observer import STOPPING, FrameWaiters, Reply
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.clock_sync import SyncState
from tacshade_edge.robot.robot_motion import ClockExchanged, RobotMotion
from tacshade_edge.robot.serial_link import SerialLink
from tacshade_edge.robot.touch_events import TouchEvents
from tacshade_edge.robot.verbs import VERBS, Command, TouchAsked, unknown_quantity
from tacshade_edge.types import Frame, Reconstruction
from tacshade_edge.wire.requests import Request
from tacshade_edge.wire.results import CommandResult, FrameCaptured

# Events of a robot that does not read: old ones are worth less than the newest.
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
    quantities: Callable[[], Sequence[str] | Reason]  # of a touch, by the calibration in use
    wake: Callable[[], None]  # called when an answer waits to be sent
    touch: TouchEvents
    # BEGIN, ADD, END, ABORT or STATUS, and a name. None without sessions, which are made after the
    # robot, since they ask it for poses.
    stitch: Callable[[str, str, Reply], None] | None = None
    # The main and the reconstruct thread put, the serial thread takes.
    _answers: SimpleQueue[tuple[Command, CommandResult | Reason]] = field(
        default_factory=SimpleQueue
    )
    # The serial thread's own: the commands in progress.
    _unanswered: list[Command] = field(default_factory=list)
    _told: deque[str] = field(default_factory=partial(deque, maxlen=TOLD_MAX))
    _captures: FrameWaiters = field(
        default_factory=partial(FrameWaiters, "captures are already waiting")
    )

    def handle(self, command: Command, link: SerialLink) -> None:
        """Start a command; called in the serial thread."""
        verb = VERBS[command.verb]
        assert verb.start is not None
        outcome: CommandResult | Reason | None = self.missing() if verb.needs_calibration else None
        if outcome is None:
            outcome = verb.start(command, self, link.counts)
        if outcome is not None:
            link.answer(command, outcome)
        else:
            self._unanswered.append(command)

    # -- what the verbs ask for (`verbs.Desk`) -----------------------------------------------------

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sensor_state(self) -> dict[str, Any]:
        return self.state()

    def sync_state(self) -> SyncState:
        return self.motion.state()

    def exchanged(self, t1_ns: int, t2_ns: int, t3_ns: int, t4_ns: int | None) -> None:
        self.motion.hear(ClockExchanged(t1_ns, t2_ns, t3_ns, t4_ns))

    def switch_touch(self, asked: TouchAsked | None) -> CommandResult | Reason:
        unknown = None if asked is None else unknown_quantity(asked, self.quantities())
        return unknown or self.touch.switch(asked)

    def capture(self, command: Command) -> None:
        # The first frame taken after the command arrived: one that was on its way shows what was
        # before.
        self._captures.put(command.arrived_ns, partial(self._answer, command))

    def request(self, request: Request, command: Command) -> None:
        self.on_request(request, partial(self._answer, command))

    def stitch_asked(self, action: str, name: str, command: Command) -> Reason | None:
        if self.stitch is None:
            return Reason(ReasonCode.UNAVAILABLE, "this daemon is not ready to stitch")
        self.stitch(action, name, partial(self._answer, command))
        return None

    # -- the answers -------------------------------------------------------------------------------

    def tell(self, event: str) -> None:
        """Send an event to the robot; with `TOLD_MAX` waiting, the oldest is dropped."""
        self._told.append(event)
        self.wake()

    def send_answers(self, link: SerialLink) -> None:
        """Give the link the answers and events since the last call; called in the serial thread."""
        # Only this thread removes, so one that was seen is still there; a full deque drops its
        # oldest itself, and neither side needs a lock.
        while self._told:
            link.notify(self._told.popleft())
        self._captures.expire(time.monotonic_ns())
        while True:
            try:
                command, outcome = self._answers.get_nowait()
            except Empty:
                return
            link.answer(command, outcome)
            self._unanswered.remove(command)

    def send_last_answers(self, link: SerialLink) -> None:
        """Give the link the answers that are there, and a refusal to each command in progress,
        which nobody will answer any more; called in the serial thread.
        """
        self.send_answers(link)
        while self._unanswered:
            link.answer(self._unanswered.pop(), STOPPING)

    @property
    def capture_pending(self) -> bool:
        return len(self._captures) > 0

    def observe(self, frame: Frame, result: Reconstruction) -> None:
        """Answer the captures that arrived before this frame was taken."""
        # In the reconstruct thread, which must not wait for the port: answers are queued.
        for answer in self._captures.take(frame.t_ns):
            answer(_captured(frame, result))

    def _answer(self, command: Command, outcome: CommandResult | Reason) -> None:
        self._answers.put((command, outcome))
        self.wake()


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
