"""A robot on the thread of stitching sessions: its commands, frames and the answers."""

from __future__ import annotations

import json
import threading
import time
from dataclasses import replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np

from support.calibrated_sensor import calibrated
from support.patience import patience
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.stitching.session import MapRevision
from tacshade_edge.stitching.session_worker import Sessions
from tacshade_edge.types import Frame, Pose, Reconstruction
from tacshade_edge.wire.results import SessionResult, SessionStatus

DEADLINE_S = 20.0

Outcome = SessionResult | Reason


class Robot:
    """Sends commands, shows frames, waits for answers."""

    def __init__(self, folder: Path, *, poses: Any = None) -> None:
        self.maps: list[MapRevision] = []
        self.published: dict[str, bytes] = {}
        self.sessions = Sessions(folder, "left", self.published.__setitem__, poses)
        self.sessions.publish_map = self._publish
        before = set(threading.enumerate())
        self.sessions.start()
        (self._thread,) = set(threading.enumerate()) - before
        self.seq = 0

    def _publish(self, revision: MapRevision) -> bool:
        self.maps.append(revision)
        return False

    def ask(self, action: str, name: str = "") -> Outcome:
        return wait(self.begin(action, name))

    def begin(self, action: str, name: str = "") -> SimpleQueue[Outcome]:
        answers: SimpleQueue[Outcome] = SimpleQueue()
        self.sessions.submit(action, name, answers.put)
        return answers

    def show(
        self,
        result: Reconstruction,
        x_mm: float = 0.0,
        *,
        pose: bool = True,
        t_ns: int | None = None,
    ) -> None:
        self.seq += 1
        at_ns = time.monotonic_ns() if t_ns is None else t_ns
        where = Pose(at_ns, x_mm, 0.0, 20.0, 0.0, 1.0, 0.0, 0.0) if pose else None
        frame = Frame(self.seq, at_ns, 0, np.zeros((4, 4), np.uint8), where)
        self.sessions.see(
            FrameResult(frame, calibrated(), replace(result, seq=self.seq, t_ns=at_ns))
        )

    def add(self, result: Reconstruction, x_mm: float = 0.0, *, pose: bool = True) -> Outcome:
        answers = self.begin("ADD")
        self.show(result, x_mm, pose=pose)
        return wait(answers)

    def status(self) -> dict[str, Any]:
        """The latest ``status/stitching``."""
        self.sessions.poll()
        return dict(json.loads(self.published["status/stitching"]))

    def end(self) -> None:
        self.sessions.stop(patience(DEADLINE_S))
        assert not self._thread.is_alive()


def code(outcome: Outcome) -> ReasonCode | None:
    """Why it was not done; None when it was."""
    return outcome.code if isinstance(outcome, Reason) else None


def status(robot: Robot) -> SessionStatus:
    outcome = robot.ask("STATUS")
    assert isinstance(outcome, SessionStatus)
    return outcome


def wait(answers: SimpleQueue[Outcome]) -> Outcome:
    try:
        return answers.get(timeout=patience(DEADLINE_S))
    except Empty:
        raise AssertionError("no answer") from None
