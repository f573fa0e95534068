"""What the robot's commands do. They arrive in the serial thread and are answered through a queue, from any thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any, Protocol

import msgspec

from tacshade_edge.daemon.robot.motion import RobotMotion
from tacshade_edge.protocol.messages import Request
from tacshade_edge.protocol.serial_link import Command, SerialLink
from tacshade_edge.types import Frame, Reconstruction

CAPTURE_TIMEOUT_NS = 5_000_000_000
WAITING_MAX = 16


class Stitching(Protocol):
    """A stitching session, for the verbs STITCH BEGIN, ADD, END, ABORT and STATUS."""

    def stitch(self, action: str, name: str, answer: Callable[[str, str], None]) -> None:
        """Do `action` (``BEGIN`` ...; `name` is empty where none was given) without waiting.

        `answer(code, text)` is called once, now or later, from any thread; `code` is empty when it was done, else
        one capital word, and `text` says what, or why not.
        """
        ...


@dataclass(frozen=True, slots=True)
class _Answer:
    command: Command
    code: str  # empty: OK
    text: str


class SerialCommands:
    """Does each command once and answers it once.

    Parameters
    ----------
    motion : RobotMotion
    on_request : callable
        Takes a `Request` for the main thread, as MQTT's are; what it answers comes to `answered`.
    state : callable
        The daemon's state, as for ``req/status``.
    wake : callable
        Called when an answer waits to be sent.

    Attributes
    ----------
    stitching : Stitching or None
        None answers ``UNAVAILABLE``.
    """

    def __init__(
        self,
        motion: RobotMotion,
        on_request: Callable[[Request], None],
        state: Callable[[], dict[str, Any]],
        wake: Callable[[], None],
    ) -> None:
        self.stitching: Stitching | None = None
        self._motion = motion
        self._on_request = on_request
        self._state = state
        self._wake = wake
        self._answers: SimpleQueue[_Answer] = SimpleQueue()
        self._lock = threading.Lock()
        self._captures: list[Command] = []
        self._requests: list[tuple[Request, Command]] = []

    def handle(self, command: Command, link: SerialLink) -> None:
        """Begin a command; called in the serial thread."""
        if command.verb == "SYNC":
            t1_ns, *rest = map(int, command.args)
            self._motion.asked(t1_ns, command.arrived_ns, rest[0] if rest else None)
            t3_ns = time.monotonic_ns()
            link.reply(command, f"{command.arrived_ns} {t3_ns}")
            self._motion.replied(t3_ns)
        elif command.verb == "STATUS":
            link.reply(command, self._status(link))
        elif command.verb == "CAPTURE":
            with self._lock:
                busy = len(self._captures) >= WAITING_MAX
                if not busy:
                    self._captures.append(command)
            if busy:
                link.refuse(command, "BUSY", f"{WAITING_MAX} captures are waiting")
        elif command.verb == "REFERENCE":
            request = Request("reference")
            with self._lock:
                self._requests.append((request, command))
            self._on_request(request)
        elif self.stitching is None:
            link.refuse(command, "UNAVAILABLE", "this daemon does not stitch yet")
        else:
            action, *name = command.args
            self.stitching.stitch(action, name[0] if name else "", self._answer_to(command))

    def send_answers(self, link: SerialLink) -> None:
        """Give the link what was answered since; called in the serial thread."""
        now_ns = time.monotonic_ns()
        with self._lock:
            late = [c for c in self._captures if now_ns - c.arrived_ns > CAPTURE_TIMEOUT_NS]
            self._captures = [c for c in self._captures if c not in late]
        for command in late:
            link.refuse(command, "TIMEOUT", f"no frame within {CAPTURE_TIMEOUT_NS / 1e9:.0f} s")
        while True:
            try:
                answer = self._answers.get_nowait()
            except Empty:
                return
            if answer.code:
                link.refuse(answer.command, answer.code, answer.text)
            else:
                link.reply(answer.command, answer.text)

    @property
    def waits_for_a_frame(self) -> bool:
        """Whether a CAPTURE wants the next reconstruction."""
        return bool(self._captures)

    def reconstructed(self, frame: Frame, result: Reconstruction) -> None:
        """A frame was: answers the captures that were asked for before it was taken."""
        if not self._captures:
            return
        with self._lock:
            ready = [c for c in self._captures if c.arrived_ns <= frame.t_ns]
            self._captures = [c for c in self._captures if c not in ready]
        for command in ready:
            self._answer_to(command)("" if result.valid else "INVALID", _capture(frame, result))

    def answered(self, request: Request, payload: bytes) -> bool:
        """The main thread's answer to a request: True when it was one of the robot's."""
        with self._lock:
            command = next((c for r, c in self._requests if r is request), None)
            self._requests = [(r, c) for r, c in self._requests if r is not request]
        if command is None:
            return False
        answer = msgspec.json.decode(payload)
        if answer["ok"]:
            self._answer_to(command)("", " ".join(f"{key}={value}" for key, value in answer["result"].items()))
        else:
            self._answer_to(command)("REFUSED", answer["error"])
        return True

    def _answer_to(self, command: Command) -> Callable[[str, str], None]:
        def answer(code: str, text: str) -> None:
            self._answers.put(_Answer(command, code, text))
            self._wake()

        return answer

    def _status(self, link: SerialLink) -> str:
        state, sync, counts = self._state(), self._motion.state(), link.counts
        return (
            f"camera={state['source']} fps={state['health'].get('delivered_fps', 0)} sync={sync.mode} "
            f"error_us={sync.error_us} drift_ppm={sync.drift_ppm} poses={counts.poses} lost={counts.poses_lost} "
            f"damaged={counts.damaged} garbage={counts.garbage}"
        )


def _capture(frame: Frame, result: Reconstruction) -> str:
    if not result.valid:
        return f"frame={result.seq}: {result.reason}"
    area_mm2 = sum(o.area_mm2 for o in result.objects)
    text = (
        f"frame={result.seq} t_ns={result.t_ns} contact={int(result.contact)} depth_mm={result.depth_max_mm:.3f} "
        f"area_mm2={area_mm2:.1f} objects={len(result.objects)} pose={int(frame.pose is not None)}"
    )
    return text if frame.pose is None else f"{text} pose_error_us={frame.pose_error_us}"
