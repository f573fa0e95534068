"""A robot on a pty and the daemon's side of it, with real threads and ports."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.patience import wait_until
from support.robot import PtyRobot, motion
from support.robot_side import Side
from tacshade_edge.pipeline.observer import WAITING_MAX, FrameResult
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.port import SerialPort
from tacshade_edge.types import (
    Calibration,
    Frame,
    HeightMap,
    Need,
    ObjectCloud,
    Pose,
    Reconstruction,
)
from tacshade_edge.wire.results import ReferenceTaken, SessionBegun


def frame(t_ns: int, calibration: Calibration, valid: bool = True) -> tuple[Frame, Reconstruction]:
    image = np.zeros((2, 2), np.uint8)
    height = HeightMap(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.bool_), 0, 0, 1)
    cloud = ObjectCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16))
    reason = None if valid else Reason(ReasonCode.BLACK, "black")
    return (
        Frame(5, t_ns, 0, image),
        Reconstruction(5, t_ns, 0, "fast", valid, reason, False, False, None, height, cloud),
    )


@pytest.mark.parametrize("binary", [False, True], ids=["ASCII", "BIN"])
def test_frames_get_the_pose_that_the_sensor_had(
    link: Path, binary: bool, calibration: Calibration
) -> None:
    frames = []
    with PtyRobot(link, rate_hz=200, binary=binary) as robot, Side(link) as side:
        side.until(
            "synchronised", state="connected", sync="two-way", mode="BIN" if binary else "ASCII"
        )
        wait_until(lambda: side.robot.motion.at(time.monotonic_ns() - 10_000_000), 10, "a pose")
        for _ in range(20):
            t_ns = time.monotonic_ns() - 10_000_000
            frames.append(side.robot.with_pose(frame(t_ns, calibration)[0]))
        for got in frames:
            if got.pose is None:  # this machine stopped for a moment
                continue
            truth = motion(got.t_ns / 1e9 - robot.began_s)
            found = (
                got.pose.x_mm,
                got.pose.y_mm,
                got.pose.z_mm,
                got.pose.qw,
                got.pose.qx,
                got.pose.qy,
                got.pose.qz,
            )
            slack_s = got.pose_error_us / 1e6 + 1e-4
            assert found[:3] == pytest.approx(
                truth[:3], abs=63 * slack_s + 0.02
            )  # 40 mm once in 4 s
            assert found[3:] == pytest.approx(truth[3:], abs=0.3 * slack_s + 1e-4)
            assert (got.pose.t_ns, got.pose_error_us > 0) == (got.t_ns, True)
        assert any(got.pose for got in frames)
    counts = side.robot.health()
    assert counts["frames_with_pose"] + counts["frames_without_pose"] == 20
    assert counts["exchanges"] >= 1
    assert counts["clock_restarts"] == 1  # its greeting


def test_unplugged_and_plugged_in_again_the_session_goes_on_and_the_gap_is_reported(
    link: Path,
) -> None:
    with PtyRobot(link, rate_hz=200, binary=True) as robot, Side(link) as side:
        side.until("synchronised", sync="two-way")
        robot.ask("STATUS")
        wait_until(lambda: any("camera=" in r for r in robot.replies.values()), 10, "a reply")
        number = next(n for n, r in robot.replies.items() if "camera=" in r)
        before = robot.replies[number]
        robot.unplug()
        side.until("away", state="away")
        wait_until(lambda: robot.counts.poses > 0, 5, "poses")
        pose_count = robot.counts.poses
        wait_until(lambda: robot.counts.poses > pose_count + 20, 5, "poses into nothing")
        robot.plug()
        side.until("back", state="connected", sync="two-way", mode="BIN")
        wait_until(
            lambda: any(e.startswith("READY tacshade 1 away_ms=") for e in robot.events),
            10,
            "EVT READY",
        )
        wait_until(lambda: any(e.startswith("GAP poses=") for e in robot.events), 10, "EVT GAP")
        # The same number and text: not done again,
        # the reply is the one from before the cable was pulled.
        robot.replies.clear()
        robot.number_from(number)
        robot.ask("STATUS")
        wait_until(lambda: number in robot.replies, 10, "the reply again")
        assert robot.replies[number] == before
    counts = side.robot.health()
    assert counts["reopened"] >= 1
    assert counts["poses_lost"] >= 20
    assert counts["clock_restarts"] == 1  # the greeting; not the cable


def answered(robot: PtyRobot, *parts: str) -> None:
    """Wait for an answer with these parts."""

    def found() -> bool:
        return any(all(part in reply for part in parts) for reply in robot.replies.values())

    wait_until(found, 10, " ".join(parts))


def test_a_capture_takes_the_first_frame_after_it(link: Path, calibration: Calibration) -> None:
    with PtyRobot(link, rate_hz=0) as robot, Side(link) as side:
        side.until("connected", state="connected")

        def see(frame: Frame, result: Reconstruction) -> None:
            side.robot.see(FrameResult(side.robot.with_pose(frame), calibration, result))

        old = frame(time.monotonic_ns(), calibration)
        robot.ask("CAPTURE")
        wait_until(lambda: side.robot.commands.capture_pending, 10, "CAPTURE")
        assert side.robot.need() == Need.DEPTH
        see(*old)
        assert side.robot.commands.capture_pending  # that one was from before
        see(*frame(time.monotonic_ns(), calibration))
        answered(robot, " frame=5 t_ns=")
        robot.ask("CAPTURE")
        wait_until(lambda: side.robot.commands.capture_pending, 10, "CAPTURE")
        see(*frame(time.monotonic_ns(), calibration, valid=False))
        answered(robot, "INVALID frame=5: black")
        assert side.robot.need() == Need.CONTACT


def test_a_reference_is_asked_for_and_answered(link: Path) -> None:
    with PtyRobot(link, rate_hz=0) as robot, Side(link) as side:
        side.until("connected", state="connected")
        for outcome in (
            ReferenceTaken(10, 7, 0.5),
            Reason(ReasonCode.FRAME_IN_CONTACT, "shows contact"),
        ):
            robot.ask("REFERENCE")
            wait_until(lambda: side.requests, 10, "the request")
            request, reply = side.requests.pop()
            assert request.verb == "reference"
            reply(outcome)
        answered(robot, "frames=10 calibration_crc32=7 noise_grey=0.5 stored=1")
        answered(robot, "REFUSED shows contact")


def test_a_session_is_commanded_where_maps_are_stitched(link: Path) -> None:
    with PtyRobot(link, rate_hz=0) as robot, Side(link) as side:
        side.until("connected", state="connected")
        robot.ask("STITCH BEGIN pad")
        answered(robot, "UNAVAILABLE")

        def submit(action: str, name: str, reply: Any) -> None:
            reply(
                SessionBegun(name)
                if action == "BEGIN"
                else Reason(ReasonCode.NO_SESSION, "none is open")
            )

        side.robot.commands.stitch = submit
        robot.ask("STITCH BEGIN pad")
        robot.ask("stitch end")
        answered(robot, "OK", "name=pad")
        answered(robot, "ERR", "NOSESSION none is open")


def test_a_stop_answers_what_the_robot_has_asked_and_refuses_what_is_still_at_work(
    link: Path,
) -> None:
    with PtyRobot(link, rate_hz=0) as robot:
        with Side(link) as side:
            side.until("connected", state="connected")
            robot.ask("CAPTURE")  # no frame comes
            for _ in range(2):
                robot.ask("REFERENCE")
            wait_until(lambda: len(side.requests) == 2, 10, "the requests")
            (_, done), (_, at_work) = side.requests
            done(ReferenceTaken(10, 7, 0.5))
        at_work(ReferenceTaken(10, 7, 0.5))
        wait_until(lambda: len(robot.answers) == 3, 10, "three answers")
    assert sum("OK" in each and "frames=10" in each for each in robot.answers) == 1
    assert sum("REFUSED the daemon is stopping" in each for each in robot.answers) == 2


def test_a_port_that_is_away_and_one_that_is_taken(
    link: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tacshade_edge.robot.robot.SILENT_NS", 10_000_000)
    side = Side(link)
    with side:
        assert side.until("away", state="away")["reason"] in (
            "starting",
            f"serial {link}: no such device",
        )
        side.until("away", reason=f"serial {link}: no such device")
        robot = PtyRobot(link, rate_hz=0)
        robot.plug()
        side.until("silent", state="silent", reason="received nothing for more than 0 s")
        other = Side(link)
        with other:
            other.until("taken", reason=f"serial {link}: in use by another program")
        robot.unplug()
        side.until("away again", state="away")


def test_a_capture_without_a_frame_ends_and_too_many_are_refused(
    link: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with PtyRobot(link, rate_hz=0) as robot, Side(link) as side:
        side.until("connected", state="connected")
        for _ in range(WAITING_MAX + 1):
            robot.ask("CAPTURE")
        wait_until(
            lambda: any(
                "BUSY 16 captures are already waiting" in r for r in robot.replies.values()
            ),
            10,
            "BUSY",
        )
        monkeypatch.setattr("tacshade_edge.pipeline.observer.FRAME_TIMEOUT_NS", 0)
        wait_until(
            lambda: sum("TIMEOUT no frame" in r for r in robot.replies.values()) == 16,
            10,
            "TIMEOUT",
        )
        assert not side.robot.commands.capture_pending


def test_a_chip_that_holds_bytes_back_is_reported(
    link: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    describe = SerialPort.describe
    monkeypatch.setattr(SerialPort, "describe", lambda port: {**describe(port), "latency_ms": 16})
    with PtyRobot(link), Side(link) as side:
        status = side.until("two-way", state="connected", sync="two-way")
    assert (
        status["reason"]
        == "the port's chip holds bytes back for 16 ms; tacshade-edge doctor explains the fix"
    )


def test_a_robot_that_reads_nothing_costs_no_poses(link: Path) -> None:
    robot = PtyRobot(link, rate_hz=0)
    robot.plug()
    master = robot.master
    with Side(link) as side:
        for number in range(3000):  # 120 kB of answers; a pty holds some 20
            os.set_blocking(master, True)
            os.write(master, b"#%d HELP\n" % (number % 65536))
        os.write(master, b"POSE 1 0 0 0 1 0 0 0\n")
        wait_until(lambda: side.robot.health()["poses"] == 1, 20, "the pose")
        assert side.robot.health()["unsent_bytes"] > 0
    robot.unplug()


def test_the_first_answer_for_a_frame_counts(
    link: Path, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a press would be placed differently in a session and in the recording."""
    side, answers = Side(link), iter((None, (Pose(1, 2.0, 0, 0, 1, 0, 0, 0), 100), None))
    monkeypatch.setattr(side.robot.motion, "at", lambda t_ns: next(answers))
    first, second = frame(1, calibration)[0], frame(2, calibration)[0]
    posed = [side.robot.with_interpolated_pose(each) for each in (first, second, first, second)]
    assert [each.pose and each.pose.x_mm for each in posed] == [None, 2.0, None, 2.0]
