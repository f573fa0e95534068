"""The thread of stitching sessions: commands, frames and answers, and what it publishes."""

from __future__ import annotations

import json
import os
import shutil
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.calibrated_sensor import step, unloaded
from support.patience import wait_until
from support.session_rig import DEADLINE_S, Robot, code, status, wait
from support.synced_names import synced, unsynced
from tacshade_edge.pipeline.observer import FRAME_TIMEOUT_NS, WAITING_MAX, FrameWaiters
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.port import SerialPort
from tacshade_edge.robot.robot import Robot as SerialRobot
from tacshade_edge.stitching.session import MapRevision
from tacshade_edge.stitching.stitch_file import open_session
from tacshade_edge.types import Need, Reconstruction
from tacshade_edge.wire.results import (
    NoSession,
    PressAdded,
    SessionAborted,
    SessionBegun,
    SessionEnded,
)


def test_a_frame_is_for_those_who_waited_before_it_was_taken() -> None:
    waiting, early, late = FrameWaiters("wait"), list[Reason]().append, list[Reason]().append
    waiting.put(10, early)
    waiting.put(20, late)
    assert [waiting.take(9), waiting.take(15), waiting.take(20)] == [[], [early], [late]]
    assert len(waiting) == 0


def test_who_waits_in_vain_or_is_one_too_many_is_refused() -> None:
    waiting, early, late = FrameWaiters("wait"), list[Reason](), list[Reason]()
    waiting.put(0, early.append)
    waiting.put(1, late.append)
    waiting.expire(FRAME_TIMEOUT_NS)
    assert (early, late) == ([], [])
    waiting.expire(FRAME_TIMEOUT_NS + 1)
    assert ([reason.code for reason in early], late) == ([ReasonCode.TIMEOUT], [])
    ended = Reason(ReasonCode.NO_SESSION, "the session has ended")
    waiting.refuse_all(ended)
    assert (late, len(waiting)) == ([ended], 0)
    refused = list[Reason]()
    for _ in range(WAITING_MAX + 1):
        waiting.put(0, refused.append)
    assert [reason.code for reason in refused] == [ReasonCode.BUSY]


@pytest.fixture(scope="module")
def nothing() -> Reconstruction:
    return step("fast", unloaded())


def test_a_session_from_begin_to_end(robot: Robot, ball: Reconstruction, tmp_path: Path) -> None:
    folder = tmp_path / "sessions" / "pad-1"
    robot.show(ball)
    assert robot.sessions.need() == Need.CONTACT
    assert robot.ask("BEGIN", "pad-1") == SessionBegun("pad-1")
    assert robot.sessions.need() == Need.DEPTH  # every frame, whoever listens
    for k in range(3):
        added = robot.add(ball, 3.0 * k)
        assert isinstance(added, PressAdded)
        assert (added.press, added.frame) == (k + 1, robot.seq)
        assert added.points > 100
    known = status(robot)
    assert (known.name, known.presses, known.points) == ("pad-1", 3, 3 * added.points)
    shown = {"state": "open", "reason": "", "reason_code": "", "missed": 0, "folder": ""}
    assert robot.status() == {
        **shown,
        "name": "pad-1",
        "presses": 3,
        "points": known.points,
        "revision": 3,
    }
    ended = robot.ask("END")
    assert isinstance(ended, SessionEnded)
    assert (ended.name, ended.presses, ended.used) == ("pad-1", 3, 3)
    assert robot.ask("STATUS") == NoSession()
    assert {"state": "idle", "name": "", "folder": str(folder)}.items() <= robot.status().items()
    assert robot.sessions.health() == {"presses": 3, "refused": 0, "missed": 0, "waiting": 0}
    about = json.loads((folder / "map.json").read_text())
    assert [record["used"] for record in about["presses"]] == [True] * 3
    assert [r.revision for r in robot.maps] == [1, 2, 3, 4]
    assert [bool(r.folder) for r in robot.maps] == [False, False, False, True]
    with np.load(folder / "map.npz") as npz:
        np.testing.assert_array_equal(npz["z_mm"], robot.maps[-1].raster().z_mm)


@pytest.mark.parametrize(
    ("apart_mm", "suspected"), [(0.004, ("poses_close", "m")), (60.0, ("", ""))]
)
def test_the_end_says_what_the_poses_are_suspected_of(
    robot: Robot,
    ball: Reconstruction,
    tmp_path: Path,
    apart_mm: float,
    suspected: tuple[str, str],
) -> None:
    robot.show(ball)
    robot.ask("BEGIN", "pad")
    for k in range(5):
        assert code(robot.add(ball, k * apart_mm)) is None
    ended = robot.ask("END")
    assert isinstance(ended, SessionEnded)
    assert (ended.suspected, ended.unit) == suspected
    (about,) = tmp_path.rglob("map.json")
    said = json.loads(about.read_text())["suspected"]
    assert ("are they in m?" in said) == bool(suspected[0])


def test_a_folder_of_another_owner(tmp_path: Path, ball: Reconstruction) -> None:
    first = Robot(tmp_path)
    first.show(ball)
    assert first.ask("BEGIN", "one") == SessionBegun("one")
    second = Robot(tmp_path)
    second.show(ball)
    refused = second.ask("BEGIN", "two")
    assert isinstance(refused, Reason)
    assert refused.code == ReasonCode.IN_USE
    assert f"sensor left, process {os.getpid()}" in refused.text
    assert isinstance(first.add(ball), PressAdded)
    first.end()
    # Free now: the session that is open there is of this sensor.
    assert code(second.ask("BEGIN", "two")) == ReasonCode.BUSY
    assert status(second).presses == 1
    second.end()


def test_a_session_whose_folder_was_deleted_keeps_nobody_out(
    tmp_path: Path, ball: Reconstruction
) -> None:
    robot = Robot(tmp_path)
    robot.show(ball)
    for name in ("one", "two"):
        assert robot.ask("BEGIN", name) == SessionBegun(name)
        assert isinstance(robot.add(ball), PressAdded)
        shutil.rmtree(tmp_path / name)
        assert code(robot.add(ball, 3.0)) == ReasonCode.DISK
    assert isinstance(robot.ask("ABORT"), SessionAborted)
    assert robot.ask("BEGIN", "three") == SessionBegun("three")
    robot.end()


def test_a_killed_session_goes_on(tmp_path: Path, ball: Reconstruction) -> None:
    folder = tmp_path / "sessions"
    first, whole = Robot(folder), Robot(tmp_path / "whole")
    for robot in (first, whole):
        robot.show(ball)
        robot.ask("BEGIN", "pad")
        robot.add(ball, 0.0)
        robot.add(ball, 3.0)
    first.end()  # as a kill does, it leaves the session open on the disk
    assert open_session(folder, "left") == folder / "pad"
    second = Robot(folder)
    assert (status(second).name, status(second).presses) == ("pad", 2)
    for robot in (second, whole):
        added = robot.add(ball, 6.0)
        assert isinstance(added, PressAdded)
        assert added.press == 3
        assert code(robot.ask("END")) is None
        robot.end()
    np.testing.assert_array_equal(second.maps[-1].raster().z_mm, whole.maps[-1].raster().z_mm)


def test_an_acknowledged_end_is_on_the_disk(
    tmp_path: Path, ball: Reconstruction, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = Robot(tmp_path / "sessions")
    robot.show(ball)
    robot.ask("BEGIN", "pad")
    robot.add(ball)
    calls = synced(monkeypatch)
    assert isinstance(robot.ask("END"), SessionEnded)
    assert unsynced(list(calls)) == []
    assert ("replace", tmp_path / "sessions/pad") in calls
    robot.end()


def test_what_cannot_be_added(robot: Robot, ball: Reconstruction, nothing: Reconstruction) -> None:
    assert robot.ask("ADD") == Reason(ReasonCode.NO_SESSION, "no session is open; begin one first")
    assert code(robot.ask("BEGIN")) == ReasonCode.NO_FRAME
    robot.show(nothing)
    robot.ask("BEGIN")
    assert code(robot.add(nothing)) == ReasonCode.NO_CONTACT
    black = replace(nothing, valid=False, reason=Reason(ReasonCode.BLACK, "black"))
    assert code(robot.add(black)) == ReasonCode.FRAME_INVALID
    assert code(robot.add(ball, pose=False)) == ReasonCode.NO_POSE
    assert code(robot.ask("END")) == ReasonCode.NO_PRESS
    assert code(robot.ask("BEGIN")) == ReasonCode.BUSY
    assert status(robot).presses == 0


def test_a_frame_from_before_the_command_is_not_taken(robot: Robot, ball: Reconstruction) -> None:
    robot.show(ball)
    robot.ask("BEGIN")
    answers = robot.begin("ADD")
    robot.show(ball, t_ns=time.monotonic_ns() - 10**9)
    robot.show(ball, 5.0)
    added = wait(answers)
    assert isinstance(added, PressAdded)
    assert added.frame == robot.seq


def test_no_frame_in_time(
    robot: Robot, ball: Reconstruction, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.show(ball)
    robot.ask("BEGIN")
    answers = robot.begin("ADD")
    robot.sessions.poll()
    assert answers.empty()
    monkeypatch.setattr("tacshade_edge.pipeline.observer.FRAME_TIMEOUT_NS", -1)
    robot.sessions.poll()
    assert code(wait(answers)) == ReasonCode.TIMEOUT


def test_an_aborted_session_leaves_nothing(
    robot: Robot, ball: Reconstruction, tmp_path: Path
) -> None:
    robot.show(ball)
    robot.ask("BEGIN", "x")
    robot.add(ball)
    waiting = robot.begin("ADD")
    assert robot.ask("ABORT") == SessionAborted("x", 1)
    assert code(wait(waiting)) == ReasonCode.NO_SESSION
    assert [path.name for path in (tmp_path / "sessions").iterdir()] == [".owner"]
    assert code(robot.ask("BEGIN", "x")) is None


@pytest.mark.parametrize("name", ["../x", ".x", "x" * 65])
def test_names_stay_in_the_folder(robot: Robot, ball: Reconstruction, name: str) -> None:
    robot.show(ball)
    assert code(robot.ask("BEGIN", name)) == ReasonCode.BAD_NAME


def test_a_disk_that_fails_adds_nothing(robot: Robot, ball: Reconstruction, tmp_path: Path) -> None:
    robot.show(ball)
    robot.ask("BEGIN", "x")
    (tmp_path / "sessions" / "x" / "presses.bin").unlink()
    failed = robot.add(ball)
    assert code(failed) == ReasonCode.DISK
    assert "cannot write it" in str(failed)
    assert status(robot).presses == 0


def test_a_press_that_was_commanded_is_not_added_again_when_it_settles(
    tmp_path: Path, ball: Reconstruction, nothing: Reconstruction
) -> None:
    robot = Robot(tmp_path)
    robot.show(nothing)
    robot.ask("BEGIN")
    begun_ns = time.monotonic_ns()
    robot.show(ball, t_ns=begun_ns)
    assert code(robot.add(ball)) is None
    for k in range(30):
        robot.show(ball, t_ns=time.monotonic_ns() + k * 33_000_000)
    assert status(robot).presses == 1
    robot.end()


def test_a_frame_of_unknown_depth_is_no_press_and_ends_none(
    robot: Robot, ball: Reconstruction, nothing: Reconstruction
) -> None:
    lost = replace(nothing, touched=True)
    robot.show(nothing)
    robot.ask("BEGIN")
    begun_ns = time.monotonic_ns()
    for k in range(60):
        shown = lost if k % 20 == 19 else ball
        robot.show(shown, t_ns=begun_ns + k * 33_000_000)
    assert status(robot).presses == 1
    refused = robot.add(lost)
    assert code(refused) is ReasonCode.NO_CONTACT
    assert "its depth is unknown" in str(refused)


def test_a_deferred_map_is_published_though_nothing_more_comes(
    robot: Robot, ball: Reconstruction, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tacshade_edge.stitching.session_worker.DEFERRED_S", 0.01)
    published: list[int] = []

    def publish(revision: MapRevision) -> bool:
        published.append(revision.revision)
        return len(published) < 3

    robot.sessions.publish_map = publish
    robot.show(ball)
    robot.ask("BEGIN")
    robot.add(ball)
    wait_until(lambda: len(published) == 3, DEADLINE_S, "published again")
    robot.ask("STATUS")
    assert published == [1, 1, 1]


def test_an_open_session_of_a_robot_whose_pose_is_unknown(
    tmp_path: Path, ball: Reconstruction
) -> None:
    line = SerialRobot(
        SerialPort("/dev/none", 115200), lambda *_: None, dict, lambda _: None, lambda: None, tuple
    )
    robot = Robot(tmp_path, poses=line)
    robot.show(ball)
    robot.ask("BEGIN")
    assert (robot.status()["state"], robot.status()["reason_code"]) == ("open", "no_pose")
    robot.end()


def test_what_was_not_added_is_counted_and_published(
    tmp_path: Path, ball: Reconstruction, nothing: Reconstruction, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = Robot(tmp_path)
    assert code(robot.ask("ADD")) is ReasonCode.NO_SESSION
    robot.show(nothing)
    robot.ask("BEGIN")
    monkeypatch.setattr("tacshade_edge.stitching.press_points.REST_NS", 0)
    for _ in range(2):
        robot.show(ball, pose=False)
    wait_until(lambda: robot.status()["missed"] == 1, 20, "missed")
    assert robot.status()["reason"].endswith("the robot's pose at the frame's time is unknown")
    robot.show(nothing)
    for _ in range(2):
        robot.show(ball)
    wait_until(lambda: robot.status()["presses"] == 1, 20, "the next one")
    assert (robot.status()["reason"], robot.status()["missed"]) == ("", 1)
    assert robot.sessions.health() == {"presses": 1, "refused": 1, "missed": 1, "waiting": 0}
    robot.end()
