from __future__ import annotations

import time
from pathlib import Path

import pytest
from support.recordings import write_recording

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.daemon.replay import Progress, replay
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.storage.recording.recording import RecordedFrame, Recording
from tacshade_edge.types import Reconstruction
from tools.testbed.painted_sensor import BLACK, FREE, TOUCHED, painted_calibration

IMAGES = [FREE, TOUCHED, BLACK, TOUCHED]
PERIOD_NS = 20_000_000


def play(folder: Path, speed: float | None) -> tuple[Progress, list[tuple[int, bool, float]], list[str]]:
    """What was counted; sequence number, contact and our time of each delivery; and what was told."""
    delivered: list[tuple[int, bool, float]] = []
    told: list[str] = []

    def deliver(recorded: RecordedFrame, result: Reconstruction) -> None:
        assert result.t_ns == recorded.frame.t_ns
        delivered.append((result.seq, result.contact, time.monotonic()))

    progress = Progress()
    reconstructor = make_reconstructor(painted_calibration(), PROFILES["fast"])
    replay(Recording(folder), reconstructor, [deliver], progress, speed=speed, undecodable=told.append)
    return progress, delivered, told


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "rec", IMAGES, PERIOD_NS)


def test_every_frame_is_delivered_in_order_and_counted(folder: Path) -> None:
    progress, delivered, told = play(folder, None)
    assert [(seq, contact) for seq, contact, _ in delivered] == [(0, False), (1, True), (2, False), (3, True)]
    assert (progress.frames, progress.contacts, progress.invalid, progress.undecodable) == (4, 2, 1, 0)
    assert progress.recorded_seconds == pytest.approx(0.08)
    assert progress.speed_up == pytest.approx(0.08 / progress.seconds)
    assert progress.as_dict()["frames"] == 4
    assert told == []


def test_no_frame_comes_before_its_time(folder: Path) -> None:
    speed = 0.5
    began = time.monotonic()
    _, delivered, _ = play(folder, speed)
    for seq, _, at in delivered:
        assert at - began >= seq * PERIOD_NS / 1e9 / speed - 1e-3


def test_what_cannot_be_read_is_told_and_passed_over(folder: Path) -> None:
    (folder / "000000.png").unlink()
    progress, delivered, told = play(folder, None)
    assert [seq for seq, _, _ in delivered] == [1, 2, 3]
    assert (progress.frames, progress.undecodable) == (3, 1)
    assert progress.recorded_seconds == pytest.approx(0.06)
    assert len(told) == 1
    assert "000000.png: No such file" in told[0]


def test_nothing_done_is_no_speed() -> None:
    assert Progress().as_dict()["speed_up"] == 0
