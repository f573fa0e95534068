"""A robot on a pty, one sensor that has its line, and others that hear what it learns."""

from __future__ import annotations

import itertools
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tacshade_edge.daemon.robot import Robot
from tacshade_edge.daemon.shared_line import SharedLine, share_lines
from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.settings import Document, Serial, Settings
from tools.testbed.patience import stretched, wait_until
from tools.testbed.robot import PtyRobot

pytestmark = pytest.mark.slow

numbers = itertools.count()


def documents(**devices: str) -> list[Document]:
    """Of sensors by the ports that they name; an empty one is none."""
    serials = {name: Serial(device=device) if device else None for name, device in devices.items()}
    return [Document(Path("s.yaml"), Settings(sensor_id=n, serial=serial), {}, True) for n, serial in serials.items()]


class Side:
    """One sensor's side of the line, without camera and broker."""

    def __init__(self, port: SerialPort | None, shared: SharedLine) -> None:
        self.told: list[dict[str, Any]] = []
        state = {"source": "streaming", "health": {"delivered_fps": 30.0}}
        self.robot = Robot(
            *(port, lambda _: None, lambda: state),
            lambda payload: self.told.append(json.loads(payload)),
            lambda: None,
            shared,
        )

    def latest(self) -> dict[str, Any]:
        self.robot.poll()
        return self.told[-1] if self.told else {}


@pytest.fixture
def link() -> Iterator[Path]:
    """A place under /dev, as the settings want, that needs no root."""
    path = Path(f"/dev/shm/tacshade-shared-{os.getpid()}-{next(numbers)}")
    yield path
    path.unlink(missing_ok=True)


@pytest.fixture
def sides(link: Path) -> Iterator[tuple[Side, Side]]:
    shared = share_lines(documents(thumb=str(link), index=str(link)))
    owner, follower = Side(SerialPort(str(link), 115200), shared["thumb"]), Side(None, shared["index"])
    owner.robot.start()
    follower.robot.start()
    yield owner, follower
    for side in (owner, follower):
        side.robot.stop(stretched(5))
    for part in shared.values():
        part.close()


def both(sides: tuple[Side, Side], **wanted: Any) -> bool:
    told = [side.latest() for side in sides]
    return all(each.get(key) == value for each in told for key, value in wanted.items())


def test_the_first_that_names_a_port_has_it_and_who_is_alone_shares_nothing() -> None:
    shared = share_lines(documents(thumb="/dev/a", index="/dev/b", middle="/dev/a", ring="", little="/dev/a"))
    assert {name: part.owner for name, part in shared.items()} == dict.fromkeys(("thumb", "middle", "little"), "thumb")
    assert [len(shared["thumb"].ends), shared["thumb"].hears] == [2, None]
    for part in shared.values():
        part.close()


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


def test_a_robot_that_is_gone_is_told_to_all(link: Path, sides: tuple[Side, Side]) -> None:
    with PtyRobot(link, rate_hz=50):
        wait_until(lambda: both(sides, state="connected"), 30, "both are connected")
    wait_until(lambda: both(sides, state="away", reason_code="lost"), 20, "both are away")


def test_an_owner_that_is_gone_is_told_by_those_that_follow(link: Path, sides: tuple[Side, Side]) -> None:
    with PtyRobot(link, rate_hz=50):
        wait_until(lambda: both(sides, state="connected"), 30, "both are connected")
        sides[0].robot.stop(stretched(5))  # and polls no more
        follower = sides[1]
        wait_until(lambda: follower.latest()["reason_code"] == "no_answer", 20, "nothing is heard of the owner")
        assert follower.latest()["reason"] == "thumb, which owns the port, is sending nothing"


def test_a_follower_that_reads_nothing_keeps_nobody_waiting(link: Path) -> None:
    shared = share_lines(documents(thumb=str(link), index=str(link)))
    owner = Side(SerialPort(str(link), 115200), shared["thumb"])
    owner.robot.start()
    with PtyRobot(link, rate_hz=1000, binary=True):
        wait_until(lambda: owner.robot.health()["poses"] > 2000, 30, "poses, many more than a socket holds")
    owner.robot.stop(stretched(5))
    for part in shared.values():
        part.close()
