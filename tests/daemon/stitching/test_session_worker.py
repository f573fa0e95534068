from __future__ import annotations

import json
import os
import shutil
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from queue import Empty, SimpleQueue

import numpy as np
import pytest
from support.calibrated_sensor import calibrated, pressed, step, unloaded

from tacshade_edge.core.stitching.press_points import press_points
from tacshade_edge.core.stitching.stitcher import Stitcher
from tacshade_edge.daemon import session_worker
from tacshade_edge.daemon.session import MapRevision
from tacshade_edge.daemon.session_worker import SessionWorker
from tacshade_edge.protocol.results import (
    NoSession,
    PressAdded,
    SessionAborted,
    SessionBegun,
    SessionEnded,
    SessionResult,
    SessionStatus,
)
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import of_pose
from tacshade_edge.storage.stitching.stitch_file import open_session
from tacshade_edge.types import Frame, Pose, Reconstruction
from tools.testbed.patience import patience, wait_until

DEADLINE_S = 20.0
Outcome = SessionResult | Reason


class Robot:
    """Sends commands, shows frames, waits for answers."""

    def __init__(self, folder: Path, *, automatic: bool = False) -> None:
        self.maps: list[MapRevision] = []
        self.worker = SessionWorker(folder, "left", self.maps.append, automatic=automatic)
        self.thread = threading.Thread(target=self.worker.run)
        self.thread.start()
        self.seq = 0

    def ask(self, action: str, name: str = "") -> Outcome:
        answers = self.begin(action, name)
        return wait(answers)

    def begin(self, action: str, name: str = "") -> SimpleQueue[Outcome]:
        answers: SimpleQueue[Outcome] = SimpleQueue()
        self.worker.submit(action, name, answers.put)
        return answers

    def show(self, result: Reconstruction, x_mm: float = 0.0, *, pose: bool = True, t_ns: int | None = None) -> None:
        self.seq += 1
        at_ns = time.monotonic_ns() if t_ns is None else t_ns
        where = Pose(at_ns, x_mm, 0.0, 20.0, 0.0, 1.0, 0.0, 0.0) if pose else None
        frame = Frame(self.seq, at_ns, 0, np.zeros((4, 4), np.uint8), where)
        seen = Reconstruction(self.seq, at_ns, 0, *(getattr(result, n) for n in REST))
        self.worker.observe(frame, seen, calibrated())

    def add(self, result: Reconstruction, x_mm: float = 0.0, *, pose: bool = True) -> Outcome:
        answers = self.begin("ADD")
        self.show(result, x_mm, pose=pose)
        return wait(answers)

    def end(self) -> None:
        self.worker.stop()
        self.thread.join(patience(DEADLINE_S))
        assert not self.thread.is_alive()


REST = (
    "profile", "valid", "reason", "contact", "saturated", "degraded", "height", "cloud", "objects", "volume_mm3",
    "repaired_px",
)  # fmt: skip


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


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    one = Robot(tmp_path / "sessions")
    yield one
    one.end()


@pytest.fixture(scope="module")
def ball() -> Reconstruction:
    return step("fast", pressed("ball", 3.0).image)


@pytest.fixture(scope="module")
def nothing() -> Reconstruction:
    return step("fast", unloaded())


def test_a_session_from_begin_to_end(robot: Robot, ball: Reconstruction, tmp_path: Path) -> None:
    robot.show(ball)
    assert robot.ask("BEGIN", "pad-1") == SessionBegun("pad-1")
    for k in range(3):
        added = robot.add(ball, 3.0 * k)
        assert isinstance(added, PressAdded)
        assert (added.press, added.frame) == (k + 1, robot.seq)
        assert added.points > 100
    assert (status(robot).name, status(robot).presses) == ("pad-1", 3)
    ended = robot.ask("END")
    assert isinstance(ended, SessionEnded)
    assert (ended.name, ended.presses, ended.used) == ("pad-1", 3, 3)
    assert robot.ask("STATUS") == NoSession()
    folder = tmp_path / "sessions" / "pad-1"
    about = json.loads((folder / "map.json").read_text())
    assert [record["used"] for record in about["presses"]] == [True] * 3
    assert [r.revision for r in robot.maps] == [1, 2, 3, 4]
    assert [bool(r.folder) for r in robot.maps] == [False, False, False, True]
    with np.load(folder / "map.npz") as npz:
        np.testing.assert_array_equal(npz["z_mm"], robot.maps[-1].raster().z_mm)


def test_the_map_is_the_offline_one(robot: Robot, ball: Reconstruction) -> None:
    robot.show(ball)
    robot.ask("BEGIN")
    offline = Stitcher(calibrated().geometry.skin_radius_mm)
    for x_mm in (0.0, 2.0, 4.0):
        robot.add(ball, x_mm)
        pose = of_pose(Pose(0, x_mm, 0.0, 20.0, 0.0, 1.0, 0.0, 0.0))
        offline.add(press_points(ball.height, calibrated().geometry), pose)
    robot.ask("END")
    np.testing.assert_array_equal(robot.maps[-1].raster().z_mm, offline.finish().raster.z_mm)


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


def test_a_session_whose_folder_was_deleted_keeps_nobody_out(tmp_path: Path, ball: Reconstruction) -> None:
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


def test_no_frame_in_time(robot: Robot, ball: Reconstruction, monkeypatch: pytest.MonkeyPatch) -> None:
    robot.show(ball)
    robot.ask("BEGIN")
    answers = robot.begin("ADD")
    robot.worker.poll()
    assert answers.empty()
    monkeypatch.setattr("tacshade_edge.daemon.session_worker.ADD_TIMEOUT_NS", -1)
    robot.worker.poll()
    assert code(wait(answers)) == ReasonCode.TIMEOUT


def test_settled_contacts_are_added_by_themselves(
    tmp_path: Path, ball: Reconstruction, nothing: Reconstruction
) -> None:
    robot = Robot(tmp_path, automatic=True)
    robot.show(nothing)
    robot.ask("BEGIN")
    start_ns = time.monotonic_ns()
    for k in range(60):
        touching = k % 30 >= 10
        robot.show(ball if touching else nothing, t_ns=start_ns + k * 33_000_000)
    assert status(robot).presses == 2
    robot.end()


def test_an_aborted_session_leaves_nothing(robot: Robot, ball: Reconstruction, tmp_path: Path) -> None:
    robot.show(ball)
    robot.ask("BEGIN", "x")
    robot.add(ball)
    waiting = robot.begin("ADD")
    assert robot.ask("ABORT") == SessionAborted("x", 1)
    assert code(wait(waiting)) == ReasonCode.NO_SESSION
    assert [path.name for path in (tmp_path / "sessions").iterdir()] == [".owner"]
    assert code(robot.ask("BEGIN", "x")) is None


@pytest.mark.parametrize("action", ["END", "ABORT"])
def test_what_a_session_took_goes_back_to_the_system(
    robot: Robot, ball: Reconstruction, action: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    returned: SimpleQueue[None] = SimpleQueue()
    monkeypatch.setattr(session_worker, "return_free_memory", lambda: returned.put(None))
    robot.show(ball)
    robot.ask("BEGIN", "x")
    assert isinstance(robot.add(ball), PressAdded)
    assert returned.empty()
    robot.ask(action)
    returned.get(timeout=patience(DEADLINE_S))


@pytest.mark.parametrize("name", ["../x", "a/b", ".x", "a b", "é", "x" * 65])
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
    robot = Robot(tmp_path, automatic=True)
    robot.show(nothing)
    robot.ask("BEGIN")
    begun_ns = time.monotonic_ns()
    robot.show(ball, t_ns=begun_ns)
    assert code(robot.add(ball)) is None
    for k in range(30):
        robot.show(ball, t_ns=time.monotonic_ns() + k * 33_000_000)
    assert status(robot).presses == 1
    robot.end()


def test_a_contact_that_is_there_when_a_session_begins_is_its_own(tmp_path: Path, ball: Reconstruction) -> None:
    robot = Robot(tmp_path, automatic=True)
    robot.show(ball)
    begun_ns = time.monotonic_ns()
    for name in ("a", "b"):  # without lifting
        robot.ask("BEGIN", name)
        for k in range(12):
            robot.show(ball, t_ns=begun_ns + k * 33_000_000)
        assert status(robot).presses == 1
        robot.ask("END")
        begun_ns += 12 * 33_000_000
    robot.end()


def test_a_touch_of_nothing_is_no_press(robot: Robot, ball: Reconstruction) -> None:
    robot.show(ball)
    robot.ask("BEGIN")
    height = replace(ball.height, contact=np.zeros_like(ball.height.contact))
    assert code(robot.add(replace(ball, height=height))) == ReasonCode.NO_CONTACT
    assert status(robot).presses == 0


def test_the_pose_is_asked_for_when_the_press_is_added(tmp_path: Path, ball: Reconstruction) -> None:
    maps: list[MapRevision] = []

    def with_pose(frame: Frame) -> Frame:
        assert frame.image.size == 0  # what waits here must not keep images
        return replace(frame, pose=Pose(frame.t_ns, 50.0, 0.0, 20.0, 0.0, 1.0, 0.0, 0.0))

    robot = Robot(tmp_path)
    robot.end()
    robot.worker = SessionWorker(tmp_path, "left", maps.append, with_pose)
    robot.thread = threading.Thread(target=robot.worker.run)
    robot.thread.start()
    robot.show(ball)
    robot.ask("BEGIN")
    assert code(robot.add(ball, pose=False)) is None
    robot.end()
    assert maps[-1].raster().x0_mm > 30


def test_a_resumed_map_is_published_at_once(tmp_path: Path, ball: Reconstruction) -> None:
    first = Robot(tmp_path)
    first.show(ball)
    first.ask("BEGIN", "pad")
    first.add(ball)
    first.end()
    second = Robot(tmp_path)
    second.ask("STATUS")
    assert [(r.name, r.revision, r.presses, r.folder) for r in second.maps] == [("pad", 1, 1, "")]
    assert second.worker.state.presses == 1
    second.end()


def test_a_folder_that_cannot_be_is_told(tmp_path: Path, ball: Reconstruction) -> None:
    robot = Robot(tmp_path / ("x" * 300))
    robot.show(ball)
    failed = robot.ask("BEGIN", "pad")
    assert (code(failed), "File name too long" in str(failed)) == (ReasonCode.DISK, True)
    assert robot.ask("STATUS") == NoSession()
    robot.end()


def test_a_deferred_map_is_published_though_nothing_more_comes(
    tmp_path: Path, ball: Reconstruction, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tacshade_edge.daemon.session_worker.DEFERRED_S", 0.01)
    published: list[int] = []

    def publish(revision: MapRevision) -> bool:
        published.append(revision.revision)
        return len(published) < 3

    robot = Robot(tmp_path)
    robot.end()
    robot.worker = SessionWorker(tmp_path, "left", publish)
    robot.thread = threading.Thread(target=robot.worker.run)
    robot.thread.start()
    robot.show(ball)
    robot.ask("BEGIN")
    robot.add(ball)
    wait_until(lambda: len(published) == 3, DEADLINE_S, "published again")
    robot.ask("STATUS")
    robot.end()
    assert published == [1, 1, 1]
