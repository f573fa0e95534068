"""The daemon with a robot: poses in height maps, commands, and a pad that it presses into a map."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support.calibrated_sensor import HALF, calibrated, simulated, unloaded
from support.patience import patience, wait_until
from support.robot import PtyRobot, motion
from support.running_app import BASE, Live, paced
from tacshade_edge.cli import main
from tacshade_edge.lab.simulator.pad import Bar, Pad, scan
from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.recording.frame_table import read_table
from tacshade_edge.robot.pose import PoseValues
from tacshade_edge.stitching.stitch_file import StitchFile
from tacshade_edge.stitching.stitcher import FinishedMap, Stitcher
from tacshade_edge.types import U8
from tacshade_edge.wire import binary

pytestmark = [pytest.mark.broker, pytest.mark.slow]
PAD = Pad(12.0, 4.0, (Bar(2.0, 2.0, 10.0, 2.0, 3.0),))
HOME: PoseValues = (0.0, 0.0, 60.0, 0.0, 1.0, 0.0, 0.0)
DEADLINE_S = 60.0


def test_poses_and_commands_from_the_line_to_a_subscriber(
    live: Live, link: Path, pictures: Any, scripted: Any
) -> None:
    touched = threading.Event()

    def stream() -> Iterator[Any]:
        while True:
            yield from paced(pictures.touched if touched.is_set() else pictures.free, 1)

    def assert_near(pose: Any, t_ns: int, slack_mm: float) -> None:
        assert (pose.x_mm, pose.y_mm) == pytest.approx(
            motion(t_ns / 1e9 - robot.began_s)[:2], abs=slack_mm
        )

    def answer(text: str) -> str:
        before = len(robot.answers)
        robot.ask(text)
        wait_until(lambda: robot.answers[before:], 15, f"an answer to {text}")
        return robot.answers[before]

    with (
        PtyRobot(link, rate_hz=200, binary=True) as robot,
        live.run(scripted(stream()), f"serial: {{device: {link}}}\n"),
    ):
        status = live.until("status/serial", sync="two-way")
        assert (status["state"], status["reason"], status["mode"]) == ("connected", "", "BIN")
        assert status["device"] == str(link)
        assert "frames=10 calibration_crc32=" in answer("REFERENCE")
        assert "camera=streaming fps=" in answer("STATUS")
        touched.set()
        wait_until(
            lambda: any(binary.decode(p).pose for p in live.payloads("height")), 10, "a pose"
        )
        assert " contact=1 depth_mm=" in answer("CAPTURE")
        refused = answer("REFERENCE")
        assert refused.startswith("ERR")
        assert "found a contact" in refused
        for message in map(binary.decode, live.payloads("height")):
            if message.pose is not None:
                assert_near(
                    message.pose, message.t_ns, 63 * (message.pose_error_us / 1e6 + 1e-4) + 0.02
                )
                assert 0 < message.pose_error_us < 100_000
        assert live.ask("record", action="start", seconds=60, name="r")["ok"]
        wait_until(lambda: live.last("status/recorder").get("frames", 0) > 10, 15, "a recording")
        assert live.ask("record", action="stop")["ok"]
        rows = [row for row in read_table(live.folder / "recs" / "r" / "frames.csv") if row.pose]
        assert rows
        for row in rows:
            assert_near(row.pose, row.t_ns, 0.3)
        wait_until(
            lambda: live.last("health").get("serial", {}).get("frames_with_pose", 0) > 0,
            10,
            "health",
        )
        robot.unplug()
        live.until("status/serial", state="away")
        robot.plug()
        live.until("status/serial", state="connected")


@cache
def presses() -> list[tuple[PoseValues, U8]]:
    """Where the robot goes down, and what the sensor sees there."""
    found = []
    for k, pose in enumerate(scan(PAD, 4.0, 2.5, HALF.skin_radius_mm)[:4]):
        shape = PAD.under(pose, HALF.skin_radius_mm)
        found.append(
            (pose.seven(), simulated().frame((Press(shape, 0.0, 0.0, 0.0),), 70 + k).image)
        )
    return found


class Cell:
    """Robot, sensor, daemon, broker and subscriber;
    the test says where the robot is and what the sensor sees.
    """

    def __init__(self, live: Live, link: Path, scripted: Any) -> None:
        self.live, self.last = live, live.last
        self._scripted = scripted
        self._closing = ExitStack()
        self.place, self.shown, self.frames = HOME, unloaded(), threading.Event()
        self.robot = self._closing.enter_context(
            PtyRobot(link, rate_hz=100, binary=True, where=lambda _: self.place)
        )
        self._settings = live.document(
            f"profile: fast\nserial: {{device: {link}}}\nstitching: {{folder: maps}}\n"
        )
        self.start()

    def start(self) -> None:
        self._app = self.live.run(self._scripted(self._stream()), self._settings, calibrated())
        there = (["online"], ["degraded"])  # after an earlier one's `stopped`
        self.until(lambda: self.live.states()[-1:] in there, "the daemon is there")
        self.until(lambda: self.last("status/serial").get("sync") == "two-way", "synchronised")

    def stop(self) -> None:
        self.frames.set()
        self._app.end()

    def close(self) -> None:
        self.stop()
        self._closing.close()

    def _stream(self) -> Iterator[Any]:
        pause = threading.Event()
        yield self.frames.wait
        while True:
            yield self.shown
            yield lambda: pause.wait(0.02)

    def until(self, condition: Callable[[], object], what: str) -> None:
        try:
            wait_until(condition, DEADLINE_S, what)
        except AssertionError as error:
            known = {
                topic: self.last(topic) for topic in ("status/serial", "status/stitching", "health")
            }
            raise AssertionError(
                f"{error}; {known}; the robot: {self.robot.counts} {self.robot.events}"
            ) from None

    def ask(self, verb: str, **request: Any) -> Any:
        """The result of a request, or its error."""
        answer = self.live.ask(verb, **request)
        return answer["result"] if answer["ok"] else answer["error"]

    def command(self, text: str) -> str:
        """The answer on the serial line."""
        before = len(self.robot.answers)
        self.robot.ask(text)
        self.until(lambda: self.robot.answers[before:], text)
        return self.robot.answers[before]

    def go(self, pose: PoseValues) -> None:
        """Lift, and move; the robot has reported it for a while when this returns."""
        self.shown = unloaded()
        self.until(lambda: self.last("contact").get("contact") == 0, "lifted")
        self.place = pose
        poses = self.robot.counts.poses
        self.until(lambda: self.robot.counts.poses > poses + 30, "poses")

    def status(self) -> Any:
        return self.last("status/stitching")

    def press(self, pose: PoseValues, image: U8, count: int) -> None:
        """Press and hold until that is added; again,
        where a starved robot's line had no pose for that instant.
        """
        missed = self.status()["missed"]
        self.go(pose)
        self.shown = image
        self.until(
            lambda: self.status()["presses"] == count or self.status()["missed"] > missed,
            f"press {count}, {self.status()}",
        )
        if self.status()["missed"] > missed:
            assert self.status()["reason_code"] == "no_pose"
            self.press(pose, image, count)


@pytest.fixture
def cell(live: Live, link: Path, scripted: Any) -> Iterator[Cell]:
    presses()  # drawn before the robot's clock runs
    calibrated()
    made = Cell(live, link, scripted)
    yield made
    made.close()


def test_an_end_that_a_stop_cuts_off_is_refused_on_both_ways_and_can_be_repeated(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.frames.set()
    cell.until(lambda: cell.last("contact"), "a frame")
    assert cell.ask("stitch", action="begin", name="1") == {"name": "1"}
    (pose, image), *_ = presses()
    cell.press(pose, image, 1)
    finish, go_on, threads = Stitcher.finish, threading.Event(), list[threading.Thread]()

    def slow(stitcher: Stitcher) -> FinishedMap:
        threads.append(threading.current_thread())
        assert go_on.wait(patience(DEADLINE_S))
        return finish(stitcher)

    monkeypatch.setattr(Stitcher, "finish", slow)
    before, asked = len(cell.robot.answers), b'{"action": "end"}'
    cell.robot.ask("STITCH END")
    cell.until(lambda: cell.status()["state"] == "ending", "ending")
    cell.live.seen.publish(f"{BASE}/req/stitch", asked)
    cell.until(lambda: cell.last("health")["stitching"]["waiting"] == 1, "another waits")
    answers = len(cell.live.payloads("res/stitch"))
    cell.stop()
    cell.until(lambda: cell.robot.answers[before:], "the robot's answer")
    assert "REFUSED the daemon is stopping" in cell.robot.answers[-1]
    cell.until(lambda: len(cell.live.payloads("res/stitch")) > answers, "the answer to MQTT")
    assert cell.last("res/stitch")["reason_code"] == "daemon_stopped"
    go_on.set()
    threads[0].join(patience(DEADLINE_S))
    cell.start()
    assert cell.ask("stitch", action="status")["presses"] == 1
    assert " presses=1 " in cell.command("STITCH END")


def test_the_live_map_is_that_of_the_recording(cell: Cell, tmp_path: Path) -> None:
    assert cell.status() == {
        **{"state": "idle", "reason": "", "reason_code": "", "name": "", "presses": 0},
        **{"points": 0, "revision": 0, "missed": 0, "folder": ""},
    }
    assert cell.ask("stitch", action="add") == "NOSESSION: no session is open; begin one first"
    folder = Path(cell.ask("record", action="start", seconds=600, name="r")["folder"])
    cell.frames.set()
    cell.until(lambda: cell.last("contact"), "a frame")
    assert cell.ask("stitch", action="begin", name="1") == {"name": "1"}
    cell.until(lambda: cell.status()["state"] == "open", "open")
    for k, (pose, image) in enumerate(presses()):
        cell.press(pose, image, k + 1)
    cell.go(HOME)
    missed = cell.status()["missed"]
    status = cell.ask("stitch", action="status")
    assert (status["open"], status["name"], status["presses"], status["revision"]) == (1, "1", 4, 4)
    assert " BUSY session 1 is open" in cell.command("STITCH BEGIN other")
    ended = cell.ask("stitch", action="end")
    assert (ended["name"], ended["presses"], ended["used"], ended["refined"]) == ("1", 4, 4, 0)
    cell.until(lambda: cell.status()["state"] == "idle", "idle")
    final = cell.last("map/final")
    counted = {"presses": 4, "refused": 1, "missed": missed, "waiting": 0}
    cell.until(lambda: cell.last("health")["stitching"] == counted, "health")
    dropped = cell.ask("record", action="stop")["dropped"]

    words = ["stitch", "--calibration", str(folder / "calibration.npz"), "--profile", "fast"]
    assert main([*words, "--recording", str(folder), "--out", str(tmp_path / "offline")]) == 0
    live, offline = Path(final["folder"]), tmp_path / "offline"
    assert live == tmp_path / "maps" / "1"
    # On a starved machine the session passes over frames, or the recording lacks some.
    for name in () if missed or dropped else ("map.ply", "map.png", "map.npz", "preview.png"):
        assert (live / name).read_bytes() == (offline / name).read_bytes(), name
    _, added = StitchFile.resume(live)
    for (_, base_T_sensor), (pose, _) in zip(
        added, presses(), strict=True
    ):  # the sensor is the flange
        np.testing.assert_allclose(
            base_T_sensor.seven()[:3], pose[:3], atol=1e-5
        )  # binary poses are float32
        assert abs(np.dot(base_T_sensor.seven()[3:], pose[3:])) == pytest.approx(1, abs=1e-6)
    with np.load(live / "map.npz") as npz:
        known = np.isfinite(npz["z_mm"])
        assert (final["presses"], final["used"], final["revision"], final["name"]) == (4, 4, 5, "1")
        assert final["area_mm2"] == np.count_nonzero(known) * npz["step_mm"] ** 2 > 50
        rows, cols = np.nonzero(known)
        x_mm, y_mm = npz["x0_mm"] + cols * npz["step_mm"], npz["y0_mm"] + rows * npz["step_mm"]
        expected = np.column_stack((x_mm, y_mm, npz["z_mm"][known])).astype(np.float32)
    cloud = binary.decode(cell.live.payloads("map/cloud")[-1])
    assert isinstance(cloud, binary.CloudMessage)
    assert cloud.seq == 5
    np.testing.assert_array_equal(cloud.points_mm, expected)
