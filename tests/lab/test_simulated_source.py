import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.lab.simulated_source import SimulatedSource
from tacshade_edge.lab.simulator.press import Press, ball
from tacshade_edge.lab.simulator.script import Script
from tacshade_edge.lab.simulator.sensor_model import SensorModel

SMALL = replace(
    SensorModel(),
    image_height_px=48,
    image_width_px=64,
    row_c=23.0,
    col_c=31.0,
    disc_radius_px=20.0,
)
SCRIPT = Script((Press(ball(5.0), depth_mm=3.0),), approach=1, hold=1, release=1, pause=1)


def source(fps: float = 200.0) -> SimulatedSource:
    return SimulatedSource(fps=fps, model=SMALL, script=SCRIPT)


def test_frames_come_at_their_time_stamps_one_period_apart() -> None:
    camera: FrameSource = source()
    camera.open()
    frames = []
    for _ in range(20):
        frame = camera.read()
        assert frame is not None
        now_ns = time.monotonic_ns()
        assert frame.t_ns <= now_ns
        assert abs((time.time_ns() - frame.wall_ns) - (now_ns - frame.t_ns)) < 1_000_000_000
        assert frame.image.shape == (48, 64, 3)
        frames.append(frame)
    for one, other in pairwise(frames):
        assert other.t_ns - one.t_ns == (other.seq - one.seq) * 5_000_000
    assert camera.dropped == frames[-1].seq - 19
    camera.close()


def test_a_clock_that_was_set_to_1970_gives_no_time_before_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    camera = source()
    camera.open()
    assert camera.read().wall_ns == 0
    camera.close()


def test_what_was_not_read_in_time_is_dropped_and_counted() -> None:
    camera = source(fps=1000.0)
    camera.open()
    first = camera.read()
    until_ns = first.t_ns + 20_000_000
    while time.monotonic_ns() < until_ns:  # a reader that is busy for 20 periods
        np.sum(first.image)
    late = camera.read()
    assert late.seq >= 20
    assert camera.dropped == late.seq - 1
    assert late.t_ns - first.t_ns == late.seq * 1_000_000


def test_a_frame_that_is_skipped_is_waited_for_and_not_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    camera: FrameSource = source(fps=20.0)
    camera.open()
    first = camera.read()
    assert first is not None
    monkeypatch.setattr(SimulatedSource, "_draw", None)
    assert camera.skip()
    assert time.monotonic_ns() >= first.t_ns + 50_000_000
    monkeypatch.undo()
    later = camera.read()
    assert later is not None
    assert later.seq == 2 + camera.dropped


def test_numbering_goes_on_after_a_reopening() -> None:
    camera = source()
    camera.open()
    last = [camera.read() for _ in range(3)][-1]
    camera.close()
    camera.close()
    camera.open()
    again = camera.read()
    assert again.seq == 3 + camera.dropped
    assert again.t_ns > last.t_ns
    assert camera.describe() == {
        "device": "simulated",
        "width_px": 64,
        "height_px": 48,
        "fps": 200.0,
    }
    assert SimulatedSource(fps=30).describe()["fps"] == 30, (
        "as it was asked for, without what rounding makes of it"
    )
