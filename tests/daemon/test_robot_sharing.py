"""A line that sensors share."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from support.patience import stretched, wait_until
from support.robot import PtyRobot
from support.robot_side import Side
from tacshade_edge.robot.robot import SharedLine, share_lines
from tacshade_edge.settings import Document, Serial, Settings


def documents(**devices: str) -> list[Document]:
    """Of sensors by the ports that they name; an empty one is none."""
    serials = {name: Serial(device=device) if device else None for name, device in devices.items()}
    return [
        Document(Path("s.yaml"), Settings(sensor_id=n, serial=serial), {}, True)
        for n, serial in serials.items()
    ]


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
    shared = share_lines(
        documents(thumb="/dev/a", index="/dev/b", middle="/dev/a", ring="", little="/dev/a")
    )
    assert {name: part.owner for name, part in shared.items()} == dict.fromkeys(
        ("thumb", "middle", "little"), "thumb"
    )
    assert [len(shared["thumb"].ends), shared["thumb"].hears] == [2, None]
    close(shared)


def test_a_follower_has_the_poses_and_the_clock_of_the_one_that_has_the_port(
    link: Path, sides: tuple[Side, Side]
) -> None:
    with PtyRobot(link, rate_hz=200, binary=True):
        wait_until(
            lambda: both(sides, state="connected", sync="two-way", mode="BIN"),
            30,
            "both are synchronised",
        )
        owner, follower = (side.robot.motion for side in sides)
        t_ns = time.monotonic_ns()
        # In a moment both have the poses before and after that time.
        wait_until(
            lambda: all(m.at(t_ns + 50_000_000) for m in (owner, follower)), 10, "poses after it"
        )
        found, followed = owner.at(t_ns), follower.at(t_ns)
        assert found is not None
        assert followed is not None
        assert followed[0].x_mm == pytest.approx(found[0].x_mm, abs=0.2)
        assert followed[1] == pytest.approx(found[1], abs=500)
        details = sides[1].latest()
        assert (details["shared_by"], details["device"]) == ("thumb", str(link))
        assert "shared_by" not in sides[0].latest()
        wait_until(
            lambda: sides[0].latest() and sides[1].robot.health().get("poses", 0) > 100,
            10,
            "its counts",
        )
        assert sides[1].robot.health()["exchanges"] >= 1


@pytest.mark.slow
def test_an_owner_that_is_gone_is_reported_by_those_that_follow(
    link: Path, sides: tuple[Side, Side]
) -> None:
    with PtyRobot(link, rate_hz=50):
        wait_until(lambda: both(sides, state="connected"), 30, "both are connected")
        sides[0].robot.stop(stretched(5))  # and polls no more
        follower = sides[1]
        wait_until(
            lambda: follower.latest()["reason_code"] == "no_answer",
            20,
            "nothing is heard of the owner",
        )
        assert follower.latest()["reason"] == "thumb, which owns the port, is sending nothing"
