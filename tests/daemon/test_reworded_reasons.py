"""Reasons are for people: with every one of their texts replaced, stitching and the serial line do the same."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.calibrated_sensor import calibrated, pressed, step, unloaded
from support.reworded import NONSENSE, reword

from tacshade_edge.core.stitching.stitcher import Stitcher
from tacshade_edge.daemon.pipeline.observer import FrameResult
from tacshade_edge.daemon.robot.motion import RobotMotion
from tacshade_edge.daemon.robot.serial_commands import SerialCommands
from tacshade_edge.daemon.robot.touch_events import TouchEvents
from tacshade_edge.daemon.stitching.session_requests import SessionRequests
from tacshade_edge.protocol.replies import encode_reply
from tacshade_edge.protocol.requests import Request
from tacshade_edge.protocol.serial.clock_sync import ClockSync
from tacshade_edge.protocol.serial.link import SerialLink
from tacshade_edge.protocol.serial.verbs import Command
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import shift
from tacshade_edge.types import Frame, Pose, Reconstruction
from tools.testbed.bumpy_surface import APEX_MM, grid_poses, press_of
from tools.testbed.patience import wait_until

DEADLINE_S = 20.0
S = 10**9


class Robot:
    """What `SessionRequests` needs of one."""

    def __init__(self) -> None:
        self.requests: list[Request] = []
        state = {"source": "streaming", "health": {}}
        touch = TouchEvents(0, lambda: None)
        self.commands = SerialCommands(
            RobotMotion(), self.requests.append, lambda: state, lambda: None, lambda: None, touch
        )

    def with_interpolated_pose(self, frame: Frame) -> Frame:
        return frame

    def knows_pose(self) -> bool:
        return True


@dataclass
class Record:
    """What was decided, and the texts beside it."""

    decisions: list[Any] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)

    def line(self, answer: str) -> None:
        """Of an ``ERR`` the number and the word decide."""
        word, seq, rest = answer.rpartition("*")[0].split(" ", 2)
        if word == "ERR":
            code, _, text = rest.partition(" ")
            self.decisions.append((word, seq, code))
            self.texts.append(text)
        else:
            self.decisions.append((word, seq, rest))

    def reply(self, reply: dict[str, Any]) -> None:
        """Of an error the keys, the code and the word before the text decide."""
        if not reply["ok"]:
            word, _, text = reply["error"].partition(": ")
            self.texts.append(text)
            reply = {**reply, "error": word}
        self.decisions.append(reply)


class Daemon:
    """Sessions with a serial line and MQTT, and frames by hand."""

    def __init__(self, folder: Path) -> None:
        self.record = Record()
        self.robot, self.link = Robot(), SerialLink()
        self.replies: list[dict[str, Any]] = []
        self.published: dict[str, bytes] = {}

        def reply(request: Request, outcome: Any) -> None:
            self.replies.append(json.loads(encode_reply(request, outcome)))

        self.sessions = SessionRequests(folder, "left", self.published.__setitem__, reply, self.robot)  # type: ignore[arg-type]
        self.sessions.start()

    def show(self, result: Reconstruction, *, pose: bool = True) -> None:
        t_ns = time.monotonic_ns()
        at = Pose(t_ns, 1.0, 2.0, 20.0, 0.0, 1.0, 0.0, 0.0) if pose else None
        frame = Frame(1, t_ns, 0, np.zeros((2, 2), np.uint8), at)
        self.sessions.see(FrameResult(frame, calibrated(), replace(result, t_ns=t_ns)))
        self.robot.commands.observe(frame, replace(result, t_ns=7))

    def send(self, text: str, then: Callable[[], None] = lambda: None) -> None:
        """A line of the robot; `then` is what its answer waits for."""
        for received in self.link.receive(text.encode() + b"\n", time.monotonic_ns()):
            if isinstance(received, Command):
                self.robot.commands.handle(received, self.link)
        then()
        output = bytearray()

        def answered() -> bytes:
            self.robot.commands.send_answers(self.link)
            output.extend(self.link.take_output())
            return bytes(output)

        wait_until(answered, DEADLINE_S, text)
        for line in output.decode().splitlines():
            self.record.line(line)

    def request(self, action: Any, name: str = "", then: Callable[[], None] = lambda: None) -> None:
        """A request over MQTT."""
        count = len(self.replies)
        self.sessions.handle(Request("stitch", 5, action=action, name=name))
        then()
        wait_until(lambda: len(self.replies) > count, DEADLINE_S, action)
        self.record.reply(self.replies[-1])

    def note_status(self) -> None:
        self.sessions.poll()
        status = json.loads(self.published["status/stitching"])
        self.record.texts.append(status.pop("reason"))
        status["folder"] = bool(status["folder"])
        self.record.decisions.append((status, self.sessions.health()))

    def complete(self, outcome: Reason) -> None:
        """The main thread's answer to the robot's request."""
        assert self.robot.commands.complete(self.robot.requests.pop(), outcome)

    def missed(self, count: int) -> bool:
        return self.sessions.health()["missed"] == count


def commands(folder: Path, ball: Reconstruction, free: Reconstruction) -> Record:
    """Every refusal of a session and of the line, and a session between them."""
    daemon = Daemon(folder)
    invalid = replace(free, valid=False, reason=Reason(ReasonCode.BLACK, "black"))
    try:
        daemon.send("#1 STITCH ADD")
        daemon.request("end")
        daemon.send("#2 STITCH BEGIN pad")
        daemon.show(free)
        daemon.send("#3 STITCH BEGIN a/b")
        daemon.send("#4 STITCH BEGIN pad")
        daemon.request("begin", "other")
        daemon.send("#4 STITCH BEGIN pad")  # its reply again
        daemon.send("#4 STITCH BEGIN new")
        daemon.request("end")
        daemon.send("#5 STITCH ADD", lambda: daemon.show(free))
        daemon.send("#6 STITCH ADD", lambda: daemon.show(invalid))
        daemon.send("#7 STITCH ADD", lambda: daemon.show(ball, pose=False))
        daemon.request("add", "", lambda: daemon.show(ball))
        daemon.note_status()
        daemon.show(free)
        daemon.show(ball, pose=False)  # at rest at once, and missed
        daemon.show(ball, pose=False)
        wait_until(lambda: daemon.missed(1), DEADLINE_S, "a contact that was missed")
        daemon.note_status()
        daemon.request("status")
        daemon.request("end")
        daemon.note_status()
        daemon.send("#8 STITCH BEGIN pad")
        daemon.send("#9 STITCH STATUS")
        daemon.send("#10 CAPTURE", lambda: daemon.show(ball))
        daemon.send("#11 CAPTURE", lambda: daemon.show(invalid))
        outcome = Reason(ReasonCode.BUSY, "busy: already taking a reference")
        daemon.send("#12 REFERENCE", lambda: daemon.complete(outcome))
        for line in ("#13 FOO", "#14 SYNC 1.5", "#15 STITCH", "HELLO 2", "#x STATUS", "#16 STATUS*0000", "POSE 1"):
            daemon.send(line)
        daemon.record.decisions.append(daemon.link.counts.as_dict())
    finally:
        daemon.sessions.stop(DEADLINE_S)
    return daemon.record


def clock() -> list[Any]:
    """A clock that jumps, goes back and begins anew."""
    sync, states = ClockSync(), []
    for t_ns, ahead_ns in ((1, 0), (2, 0), (3, 2), (4, 2), (5, -60)):
        for k in range(60):
            robot_ns = t_ns * 60 * S + k * S
            sync.stamp_received(robot_ns + ahead_ns * S, robot_ns)
        states.append((sync.state().mode, sync.counts.restarts, replace(sync.state(), reason=None)))
    return states


def stitched() -> list[Any]:
    """A press far from where the robot reported it."""
    stitcher, poses = Stitcher(APEX_MM), grid_poses()
    for k, pose in enumerate(poses):
        stitcher.add(press_of(pose, k), shift(0, 0, 2.0 if k == 24 else 0.0) @ pose)
    finished = stitcher.finish()
    codes = [press.rejected and press.rejected.code for press in finished.presses]
    return [codes, finished.raster.z_mm.tobytes()]


@pytest.mark.slow
def test_rewording_changes_no_behaviour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tacshade_edge.core.stitching.rest.REST_NS", 0)
    ball, free = step("fast", pressed("ball", 3.0).image), step("fast", unloaded())
    first, first_clock, first_map = commands(tmp_path / "1", ball, free), clock(), stitched()

    reword(monkeypatch)
    again = commands(tmp_path / "2", ball, free)
    assert again.decisions == first.decisions
    assert (clock(), stitched()) == (first_clock, first_map)
    changed = [text for text in first.texts if text]
    assert len(set(changed)) > 15
    assert set(again.texts) <= {"", NONSENSE}
    assert sum(code is not None for code in first_map[0]) == 1
