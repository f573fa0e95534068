"""A robot on a pty and the daemon's side of it, with real threads and ports; a line that sensors share."""

from __future__ import annotations

import itertools
import json
import os
import select
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacshade_edge.daemon.observer import WAITING_MAX, FrameResult, Reply
from tacshade_edge.daemon.robot import Robot, SharedLine, share_lines
from tacshade_edge.daemon.serial_line import TouchEvents
from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.protocol.requests import Request
from tacshade_edge.protocol.results import ReferenceTaken, SessionBegun, TouchSwitched
from tacshade_edge.protocol.serial.commands import TouchAsked
from tacshade_edge.protocol.serial.framing import cobs_decode, cobs_encode
from tacshade_edge.protocol.serial.line import seal
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.settings import Document, Serial, Settings
from tacshade_edge.types import Calibration, Frame, HeightMap, Need, ObjectCloud, Pose, Reconstruction, Touch
from tools.testbed.patience import patience, stretched, wait_until
from tools.testbed.robot import PtyRobot, motion

numbers = itertools.count()


@pytest.fixture
def link() -> Iterator[Path]:
    """A place under /dev, as the settings want, that needs no root."""
    path = Path(f"/dev/shm/tacshade-test-{os.getpid()}-{next(numbers)}")
    yield path
    path.unlink(missing_ok=True)


class Side:
    """One sensor's side of the line, without camera and broker; without a link it follows another's."""

    def __init__(self, link: Path | None, shared: SharedLine | None = None) -> None:
        self.requests: list[tuple[Request, Reply]] = []
        self.reports: list[dict[str, Any]] = []
        self.robot = Robot(
            SerialPort(str(link), 115200) if link else None,
            lambda *request: self.requests.append(request),
            lambda: {"source": "streaming", "health": {"delivered_fps": 30.0}},
            lambda payload: self.reports.append(json.loads(payload)),
            lambda: None,
            shared,
        )

    def __enter__(self) -> Side:
        self.robot.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.robot.stop(10)

    def latest(self) -> dict[str, Any]:
        """``status/serial``."""
        self.robot.poll()
        return self.reports[-1] if self.reports else {}

    def until(self, what: str, **wanted: Any) -> dict[str, Any]:
        wait_until(lambda: wanted.items() <= self.latest().items(), 30, f"{what}: {wanted}")
        return self.reports[-1]


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
def test_frames_get_the_pose_that_the_sensor_had(link: Path, binary: bool, calibration: Calibration) -> None:
    frames = []
    with PtyRobot(link, rate_hz=200, binary=binary) as robot, Side(link) as side:
        side.until("synchronised", state="connected", sync="two-way", mode="BIN" if binary else "ASCII")
        wait_until(lambda: side.robot.motion.at(time.monotonic_ns() - 10_000_000), 10, "a pose")
        for _ in range(20):
            t_ns = time.monotonic_ns() - 10_000_000
            frames.append(side.robot.with_pose(frame(t_ns, calibration)[0]))
        for got in frames:
            if got.pose is None:  # this machine stopped for a moment
                continue
            truth = motion(got.t_ns / 1e9 - robot.began_s)
            found = (got.pose.x_mm, got.pose.y_mm, got.pose.z_mm, got.pose.qw, got.pose.qx, got.pose.qy, got.pose.qz)
            slack_s = got.pose_error_us / 1e6 + 1e-4
            assert found[:3] == pytest.approx(truth[:3], abs=63 * slack_s + 0.02)  # 40 mm once in 4 s
            assert found[3:] == pytest.approx(truth[3:], abs=0.3 * slack_s + 1e-4)
            assert (got.pose.t_ns, got.pose_error_us > 0) == (got.t_ns, True)
        assert any(got.pose for got in frames)
    counts = side.robot.health()
    assert counts["frames_with_pose"] + counts["frames_without_pose"] == 20
    assert counts["exchanges"] >= 1
    assert counts["clock_restarts"] == 1  # its greeting


def test_unplugged_and_plugged_in_again_the_session_goes_on_and_the_gap_is_reported(link: Path) -> None:
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
        wait_until(lambda: any(e.startswith("READY tacshade 1 away_ms=") for e in robot.events), 10, "EVT READY")
        wait_until(lambda: any(e.startswith("GAP poses=") for e in robot.events), 10, "EVT GAP")
        # The same number and text: not done again, the reply is the one from before the cable was pulled.
        robot.replies.clear()
        robot._seq = number - 1
        robot.ask("STATUS")
        wait_until(lambda: number in robot.replies, 10, "the reply again")
        assert robot.replies[number] == before
    counts = side.robot.health()
    assert counts["reopened"] >= 1
    assert counts["poses_lost"] >= 20
    assert counts["clock_restarts"] == 1  # the greeting; not the cable


def test_captures_and_references(link: Path, calibration: Calibration) -> None:
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
        wait_until(lambda: any(" frame=5 t_ns=" in r for r in robot.replies.values()), 10, "its answer")
        robot.ask("CAPTURE")
        wait_until(lambda: side.robot.commands.capture_pending, 10, "CAPTURE")
        see(*frame(time.monotonic_ns(), calibration, valid=False))
        wait_until(lambda: any("INVALID frame=5: black" in r for r in robot.replies.values()), 10, "its answer")

        for outcome in (ReferenceTaken(10, 7, 0.5), Reason(ReasonCode.FRAME_IN_CONTACT, "shows contact")):
            robot.ask("REFERENCE")
            wait_until(lambda: side.requests, 10, "the request")
            request, reply = side.requests.pop()
            assert request.verb == "reference"
            reply(outcome)
        wait_until(
            lambda: any(
                r.endswith("frames=10 calibration_crc32=7 noise_grey=0.5 stored=1") for r in robot.replies.values()
            ),
            10,
            "OK",
        )
        wait_until(lambda: any(r.endswith("REFUSED shows contact") for r in robot.replies.values()), 10, "ERR")

        assert side.robot.need() == Need.CONTACT
        robot.ask("STITCH BEGIN pad")
        wait_until(lambda: any("UNAVAILABLE" in r for r in robot.replies.values()), 10, "no stitching")

        class Session:
            def submit(self, action: str, name: str, reply: Any) -> None:
                reply(SessionBegun(name) if action == "BEGIN" else Reason(ReasonCode.NO_SESSION, "none is open"))

        side.robot.commands.sessions = Session()
        robot.ask("STITCH BEGIN pad")
        robot.ask("stitch end")
        wait_until(lambda: any(r.endswith("name=pad") and "OK" in r for r in robot.replies.values()), 10, "BEGIN")
        wait_until(
            lambda: any(r.endswith("NOSESSION none is open") and "ERR" in r for r in robot.replies.values()), 10, "END"
        )


def test_a_port_that_is_away_and_one_that_is_taken(link: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tacshade_edge.daemon.robot.SILENT_NS", 10_000_000)
    side = Side(link)
    with side:
        assert side.until("away", state="away")["reason"] in ("starting", f"serial {link}: no such device")
        side.until("away", reason=f"serial {link}: no such device")
        robot = PtyRobot(link, rate_hz=0)
        robot.plug()
        side.until("silent", state="silent", reason="received nothing for more than 0 s")
        other = Side(link)
        with other:
            other.until("taken", reason=f"serial {link}: in use by another program")
        robot.unplug()
        side.until("away again", state="away")


def test_a_capture_without_a_frame_ends_and_too_many_are_refused(link: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with PtyRobot(link, rate_hz=0) as robot, Side(link) as side:
        side.until("connected", state="connected")
        for _ in range(WAITING_MAX + 1):
            robot.ask("CAPTURE")
        wait_until(lambda: any("BUSY 16 captures are already waiting" in r for r in robot.replies.values()), 10, "BUSY")
        monkeypatch.setattr("tacshade_edge.daemon.observer.FRAME_TIMEOUT_NS", 0)
        wait_until(lambda: sum("TIMEOUT no frame" in r for r in robot.replies.values()) == 16, 10, "TIMEOUT")
        assert not side.robot.commands.capture_pending


def test_a_chip_that_holds_bytes_back_is_reported(link: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    describe = SerialPort.describe
    monkeypatch.setattr(SerialPort, "describe", lambda port: {**describe(port), "latency_ms": 16})
    with PtyRobot(link), Side(link) as side:
        status = side.until("two-way", state="connected", sync="two-way")
    assert status["reason"] == "the port's chip holds bytes back for 16 ms; tacshade-edge doctor explains the fix"


def test_a_robot_that_reads_nothing_costs_no_poses(link: Path) -> None:
    robot = PtyRobot(link, rate_hz=0)
    robot.plug()
    assert robot._fds is not None
    master = robot._fds[0]
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


NS = 1_000_000_000

FREE = Reconstruction(
    *(0, 0, 0, "fast", True, None, False, False, None),
    HeightMap(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.bool_), 0, 0, 1),
    ObjectCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16)),
)


def touched(seq: int, depth_mm: float | None, t_ns: int | None = None) -> Reconstruction:
    touch = Touch({"depth_mm": depth_mm}, {"depth_mm": None})
    return replace(FREE, seq=seq, t_ns=seq * NS if t_ns is None else t_ns, contact=True, touch=touch)


class Bench:
    """The robot's end of a pty, and the daemon's part that serves it."""

    def __init__(self, baud: int = 115200) -> None:
        self.master, self._slave = os.openpty()
        self.robot = Robot(
            SerialPort(os.ttyname(self._slave), baud), lambda *_: None, dict, lambda _: None, lambda: self.missing
        )
        self.missing: Reason | None = None
        self._heard = b""
        self._numbers = count(1)

    def __enter__(self) -> Bench:
        self.robot.start()
        wait_until(lambda: "READY" in self.line(), 10, "the port")
        return self

    def __exit__(self, *_: object) -> None:
        self.robot.stop(10)
        os.close(self.master)
        os.close(self._slave)

    def line(self) -> str:
        """The next line or frame without its checksum, read one byte at a time."""
        deadline_s = time.monotonic() + patience(10)
        while time.monotonic() < deadline_s:
            if select.select([self.master], [], [], 0.1)[0]:
                byte = os.read(self.master, 1)
                if byte in b"\n\0" and self._heard:
                    raw, self._heard = self._heard, b""
                    text = cobs_decode(raw)[1:] if byte == b"\0" else raw
                    return text.decode().rpartition("*")[0]
                self._heard += byte
        raise AssertionError(f"no line, only {self._heard!r}")

    def ask(self, text: str, *, binary: bool = False) -> str:
        """The answer to a line that is sent one byte at a time."""
        sealed = seal(f"#{next(self._numbers)} {text}")
        for byte in cobs_encode(b"L" + sealed[:-1]) + b"\0" if binary else sealed:
            os.write(self.master, bytes([byte]))
        return self.line()

    def show(self, result: Reconstruction) -> None:
        self.robot.see(FrameResult(Frame(result.seq, result.t_ns, 0, np.zeros((2, 2), np.uint8)), None, result))


@pytest.fixture
def bench() -> Iterator[Bench]:
    with Bench() as made:
        yield made


@pytest.mark.parametrize("binary", [False, True], ids=["ASCII", "BIN"])
def test_each_frame_in_contact_and_one_at_the_end_until_off(bench: Bench, binary: bool) -> None:
    if binary:
        assert bench.ask("MODE BIN") == "OK 1 BIN"
    assert bench.robot.need() == Need.CONTACT
    assert bench.ask("TOUCH ON depth_mm force_z_n", binary=binary).endswith("on=1 rate_hz=60")
    assert bench.robot.need() == Need.TOUCH
    bench.show(FREE)  # nothing ended
    bench.show(replace(FREE, contact=True))  # begun before anybody asked
    bench.show(touched(7, 1.25))
    assert bench.line() == "EVT TOUCH 7 7000000000 depth_mm=1.250 force_z_n=-"
    bench.show(touched(8, None))
    assert bench.line() == "EVT TOUCH 8 8000000000 depth_mm=- force_z_n=-"
    bench.show(replace(FREE, valid=False, reason=Reason(ReasonCode.BLACK, "black")))
    bench.show(replace(FREE, seq=9, t_ns=9 * NS))
    assert bench.line() == "EVT TOUCH 9 9000000000 contact=0 depth_mm=- force_z_n=-"
    bench.show(replace(FREE, seq=10, t_ns=10 * NS))
    bench.show(touched(11, 0.5))
    assert bench.line() == "EVT TOUCH 11 11000000000 depth_mm=0.500 force_z_n=-"
    assert bench.ask("TOUCH OFF", binary=binary).endswith(" on=0")
    assert bench.robot.need() == Need.CONTACT
    bench.show(touched(12, 0.5))
    assert bench.robot.health().items() >= {"touch_events": 4, "touch_dropped": 0}.items()


def test_what_is_refused(bench: Bench) -> None:
    assert bench.ask("TOUCH") == f"ERR 1 ARGS expected {bench.ask('HELP TOUCH').removeprefix('OK 2 ')}"
    assert (
        bench.ask("TOUCH ON depth_mm 0") == "ERR 3 ARGS found the RATE 0, expected a whole number of Hz from 1 to 1000"
    )
    assert bench.ask("TOUCH ON depth_mm 500") == (
        "ERR 4 REFUSED found 34500 bytes/s (500 events/s of up to 69 bytes), expected at most 10368 bytes/s (90 % of "
        "115200 baud); use a lower RATE, fewer names or a faster line"
    )
    assert not bench.robot.need()
    bench.missing = Reason(ReasonCode.NOT_CALIBRATED, "not calibrated: do that")
    assert bench.ask("TOUCH ON depth_mm") == "ERR 5 UNCALIBRATED not calibrated: do that"


def test_a_touch_that_waits_is_replaced_by_a_newer_one() -> None:
    events = TouchEvents(10**7, lambda: None)
    events.switch(TouchAsked(("depth_mm",), 1000))
    for seq in range(1, 4):
        events.observe(touched(seq, 1.0))
    seen = events.take()
    assert seen is not None
    assert (seen.seq, events.take(), events.as_dict()) == (3, None, {"touch_events": 1, "touch_dropped": 2})


def rates(asked_hz: int, frame_hz: float, jitter_s: float = 0.0) -> list[int]:
    """Which frames of 10 s are reported."""
    events, woken = TouchEvents(10**7, lambda: None), []
    assert events.switch(TouchAsked(("depth_mm",), asked_hz)) == TouchSwitched(asked_hz)
    rng = np.random.default_rng(1)
    for k in range(int(10 * frame_hz)):
        events.observe(touched(k, 1.0, int(NS * (5 + k / frame_hz + rng.uniform(0, jitter_s)))))
        if (seen := events.take()) is not None:
            woken.append(seen.seq)
    return woken


@pytest.mark.parametrize(
    ("asked_hz", "frame_hz", "jitter_s", "expected"),
    [
        (60, 60, 0.004, 600),
        (60, 30, 0.004, 300),
        (50, 60, 0.0, 500),
        (30, 60, 0.004, 300),
        (7, 60, 0.004, 70),
        (60, 120, 0, 600),
    ],
)
def test_at_most_so_many_a_second_and_all_of_a_slower_camera(
    asked_hz: int, frame_hz: float, jitter_s: float, expected: int
) -> None:
    assert len(rates(asked_hz, frame_hz, jitter_s)) == pytest.approx(expected, abs=2)


def documents(**devices: str) -> list[Document]:
    """Of sensors by the ports that they name; an empty one is none."""
    serials = {name: Serial(device=device) if device else None for name, device in devices.items()}
    return [Document(Path("s.yaml"), Settings(sensor_id=n, serial=serial), {}, True) for n, serial in serials.items()]


@pytest.fixture
def sides(link: Path) -> Iterator[tuple[Side, Side]]:
    shared = share_lines(documents(thumb=str(link), index=str(link)))
    with Side(link, shared["thumb"]) as owner, Side(None, shared["index"]) as follower:
        yield owner, follower
    close(shared)


def close(shared: dict[str, SharedLine]) -> None:
    for part in shared.values():
        for end in (*part.ends, *([part.hears] if part.hears else [])):
            end.close()


def both(sides: tuple[Side, Side], **wanted: Any) -> bool:
    return all(wanted.items() <= side.latest().items() for side in sides)


def test_the_first_that_names_a_port_has_it_and_who_is_alone_shares_nothing() -> None:
    shared = share_lines(documents(thumb="/dev/a", index="/dev/b", middle="/dev/a", ring="", little="/dev/a"))
    assert {name: part.owner for name, part in shared.items()} == dict.fromkeys(("thumb", "middle", "little"), "thumb")
    assert [len(shared["thumb"].ends), shared["thumb"].hears] == [2, None]
    close(shared)


def test_a_follower_has_the_poses_and_the_clock_of_the_one_that_has_the_port(
    link: Path, sides: tuple[Side, Side]
) -> None:
    with PtyRobot(link, rate_hz=200, binary=True):
        wait_until(lambda: both(sides, state="connected", sync="two-way", mode="BIN"), 30, "both are synchronised")
        owner, follower = (side.robot.motion for side in sides)
        t_ns = time.monotonic_ns()
        # In a moment both have the poses before and after that time.
        wait_until(lambda: all(m.at(t_ns + 50_000_000) for m in (owner, follower)), 10, "poses after it")
        found, followed = owner.at(t_ns), follower.at(t_ns)
        assert found is not None
        assert followed is not None
        assert followed[0].x_mm == pytest.approx(found[0].x_mm, abs=0.2)
        assert followed[1] == pytest.approx(found[1], abs=500)
        details = sides[1].latest()
        assert (details["shared_by"], details["device"]) == ("thumb", str(link))
        assert "shared_by" not in sides[0].latest()
        wait_until(lambda: sides[0].latest() and sides[1].robot.health().get("poses", 0) > 100, 10, "its counts")
        assert sides[1].robot.health()["exchanges"] >= 1


def test_an_owner_that_is_gone_is_reported_by_those_that_follow(link: Path, sides: tuple[Side, Side]) -> None:
    with PtyRobot(link, rate_hz=50):
        wait_until(lambda: both(sides, state="connected"), 30, "both are connected")
        sides[0].robot.stop(stretched(5))  # and polls no more
        follower = sides[1]
        wait_until(lambda: follower.latest()["reason_code"] == "no_answer", 20, "nothing is heard of the owner")
        assert follower.latest()["reason"] == "thumb, which owns the port, is sending nothing"
