from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.calibrated_sensor import calibrated, pressed, step, unloaded

from tacshade_edge.core.stitching.stitcher import StitchedMap, Stitcher
from tacshade_edge.daemon.observer import FrameResult
from tacshade_edge.daemon.session_worker import SessionRequests
from tacshade_edge.protocol.requests import Request, encode_reply
from tacshade_edge.storage.stitching.stitch_file import open_session
from tacshade_edge.types import Frame, Need, Pose, Reconstruction
from tools.testbed.patience import patience, wait_until

BEGIN, ADD, END, STATUS = (Request("stitch", n, action=a) for n, a in enumerate(("begin", "add", "end", "status")))  # type: ignore[arg-type]


class Daemon:
    def __init__(self, folder: Path) -> None:
        self.published: dict[str, bytes] = {}
        self.replies: list[dict[str, Any]] = []
        self.sessions = SessionRequests(
            folder,
            "left",
            self.published.__setitem__,
            lambda request, outcome: self.replies.append(json.loads(encode_reply(request, outcome))),
            None,
        )
        self.sessions.start()

    def show(self, result: Reconstruction | None, *, pose: bool = True) -> None:
        t_ns = time.monotonic_ns()
        at = Pose(t_ns, 1.0, 2.0, 20.0, 0.0, 1.0, 0.0, 0.0) if pose else None
        frame = Frame(1, t_ns, 0, np.zeros((2, 2), np.uint8), at)
        seen = None if result is None else replace(result, t_ns=t_ns)
        self.sessions.see(FrameResult(frame, calibrated(), seen))

    def ask(self, request: Request, result: Reconstruction | None = None) -> dict[str, Any]:
        count = len(self.replies)
        self.sessions.handle(request)
        if result is not None:
            self.show(result)
        wait_until(lambda: len(self.replies) > count, 20, "a reply")
        return self.replies[-1]

    def status(self) -> dict[str, Any]:
        self.sessions.poll()
        return dict(json.loads(self.published["status/stitching"]))


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    one = Daemon(tmp_path)
    yield one
    one.sessions.stop(20)


@pytest.mark.slow
def test_a_session_over_mqtt(daemon: Daemon, tmp_path: Path) -> None:
    ball = step("fast", pressed("ball", 3.0).image)
    assert daemon.ask(BEGIN)["reason_code"] == "no_frame"
    daemon.show(step("fast", unloaded()))
    assert daemon.sessions.need() == Need.CONTACT
    assert daemon.ask(replace(BEGIN, name="7", transaction="t")) == {
        "transaction": "t",
        "ok": True,
        "result": {"name": "7"},
    }
    assert daemon.sessions.need() == Need.DEPTH  # every frame, whoever listens
    assert daemon.status() == {
        **{"state": "open", "reason": "", "reason_code": "", "name": "7", "presses": 0, "points": 0, "revision": 0},
        **{"missed": 0, "folder": ""},
    }
    added = daemon.ask(ADD, ball)["result"]
    assert (added["press"], added["frame"]) == (1, 1)
    assert daemon.ask(STATUS)["result"]["points"] == added["points"] > 100
    ended = daemon.ask(END)["result"]
    assert (ended["name"], ended["presses"], ended["disagreement_mm"]) == ("7", 1, 0.0)
    assert daemon.status() == {
        **{"state": "idle", "reason": "", "reason_code": "", "name": "", "presses": 0, "points": 0, "revision": 0},
        **{"missed": 0, "folder": str(tmp_path / "7")},
    }
    assert daemon.sessions.need() == Need.CONTACT
    assert {"map/cloud", "map/revision", "map/final"} <= set(daemon.published)
    assert daemon.sessions.health() == {"presses": 1, "refused": 0, "missed": 0, "waiting": 0}


def test_what_was_not_added_is_counted_and_told(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    ball = step("fast", pressed("ball", 3.0).image)
    refused = daemon.ask(ADD)
    assert (refused["error"], refused["reason_code"]) == (
        "NOSESSION: no session is open; begin one first",
        "no_session",
    )
    daemon.show(step("fast", unloaded()))
    daemon.ask(BEGIN)
    daemon.show(None)  # a contact that nobody asked for, from before
    monkeypatch.setattr("tacshade_edge.core.stitching.press_points.REST_NS", 0)
    daemon.show(ball, pose=False)
    daemon.show(ball, pose=False)
    wait_until(lambda: daemon.status()["missed"] == 1, 20, "missed")
    assert daemon.status()["reason"].endswith("the robot's pose at the frame's time is unknown")
    daemon.show(step("fast", unloaded()))
    daemon.show(ball)
    daemon.show(ball)
    wait_until(lambda: daemon.status()["presses"] == 1, 20, "the next one")
    assert (daemon.status()["reason"], daemon.status()["missed"]) == ("", 1)
    assert daemon.sessions.health() == {"presses": 1, "refused": 1, "missed": 1, "waiting": 0}


def test_a_stop_does_not_wait_for_a_map(daemon: Daemon, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    daemon.show(step("fast", unloaded()))
    daemon.ask(replace(BEGIN, name="pad"))
    daemon.ask(ADD, step("fast", pressed("ball", 3.0).image))
    finish, go_on = Stitcher.finish, threading.Event()

    def slow(stitcher: Stitcher) -> StitchedMap:
        assert go_on.wait(patience(20))
        return finish(stitcher)

    monkeypatch.setattr(Stitcher, "finish", slow)
    daemon.sessions.handle(END)
    wait_until(lambda: daemon.status()["state"] == "ending", 20, "ending")
    daemon.sessions.stop(0.01)
    assert daemon.status()["state"] == "ending"
    assert open_session(tmp_path, "left") == tmp_path / "pad"  # for the next daemon
    go_on.set()
    wait_until(lambda: daemon.status()["state"] == "idle", 20, "idle")
