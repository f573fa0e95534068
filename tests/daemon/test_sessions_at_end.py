"""The thread of stitching sessions while a map is made, and at a stop."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from support.patience import patience, wait_until
from support.session_rig import Robot, code, status, wait
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.stitching.stitch_file import open_session
from tacshade_edge.stitching.stitcher import FinishedMap, Stitcher
from tacshade_edge.types import Reconstruction
from tacshade_edge.wire.results import SessionEnded


def maps_wait(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Let no map be finished before the event is set."""
    finish, go_on = Stitcher.finish, threading.Event()

    def slow(stitcher: Stitcher) -> FinishedMap:
        assert go_on.wait(patience(20))
        return finish(stitcher)

    monkeypatch.setattr(Stitcher, "finish", slow)
    return go_on


def test_a_stop_does_not_wait_for_a_map_and_refuses_its_end_once(
    tmp_path: Path, ball: Reconstruction, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = Robot(tmp_path)
    robot.show(ball)
    robot.ask("BEGIN", "pad")
    robot.add(ball)
    go_on = maps_wait(monkeypatch)
    ended, added = robot.begin("END"), robot.begin("ADD")
    wait_until(lambda: robot.status()["state"] == "ending", 20, "ending")
    robot.sessions.stop(0.01)
    assert [code(wait(each)) for each in (ended, added)] == [ReasonCode.DAEMON_STOPPED] * 2
    assert robot.status()["state"] == "ending"
    go_on.set()
    robot.end()
    # What was refused is not done either: the next daemon's sessions go on with it, and end it.
    assert ended.empty()
    assert open_session(tmp_path, "left") == tmp_path / "pad"
    assert not (tmp_path / "pad" / "map.npz").exists()
    again = Robot(tmp_path)
    assert status(again).presses == 1
    assert isinstance(again.ask("END"), SessionEnded)
    again.end()


def test_a_press_that_waited_until_its_session_had_ended_is_refused(
    robot: Robot, ball: Reconstruction, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.show(ball)
    robot.ask("BEGIN")
    robot.add(ball)
    go_on = maps_wait(monkeypatch)
    ended = robot.begin("END")
    wait_until(lambda: robot.status()["state"] == "ending", 20, "ending")
    added = robot.begin("ADD")
    robot.show(ball)
    go_on.set()
    assert isinstance(wait(ended), SessionEnded)
    assert wait(added) == Reason(ReasonCode.NO_SESSION, "the session has ended")


def test_what_waits_at_a_stop_is_refused(robot: Robot, ball: Reconstruction) -> None:
    robot.show(ball)
    robot.ask("BEGIN")
    added = robot.begin("ADD")  # no frame comes
    robot.end()
    late = robot.begin("STATUS")
    assert [code(wait(each)) for each in (added, late)] == [ReasonCode.DAEMON_STOPPED] * 2
