"""The source against a stand-in program that speaks rpicam-vid's two streams;
nothing here was run on a board.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from support import rpicam_vid
from support.patience import patience
from tacshade_edge.camera import rpicam
from tacshade_edge.camera.rpicam import RpicamSource
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.types import Frame

pytestmark = pytest.mark.slow

H, W = 48, 64
IMAGES = np.random.default_rng(7).integers(0, 256, (5, H, W), np.uint8)


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Put the program on the path; called, it says what it does."""
    rpicam_vid.put_on_path(tmp_path, monkeypatch)
    monkeypatch.setattr(rpicam, "_START_S", patience(5.0))
    np.save(tmp_path / "frames.npy", IMAGES)

    def does(**what: Any) -> None:
        monkeypatch.setenv("STAND_IN", json.dumps({"frames": str(tmp_path / "frames.npy")} | what))

    does()
    return does


def source(fps: float = 50, exposure_us: int = 4000) -> RpicamSource:
    return RpicamSource(
        camera=0, width_px=W, height_px=H, fps=fps, exposure_us=exposure_us, gain=2.0
    )


def frames(camera: RpicamSource, count: int) -> list[Frame]:
    camera.open()
    try:
        return [frame for _ in range(count) if (frame := camera.read())]
    finally:
        camera.close()


def test_the_luma_of_each_frame_and_the_sensors_time(stand_in: Callable[..., None]) -> None:
    camera = source()
    found = frames(camera, 40)
    for n, frame in enumerate(found):
        np.testing.assert_array_equal(frame.image, IMAGES[n % len(IMAGES)])
    assert [frame.seq for frame in found] == list(range(40))
    assert {found[n + 1].t_ns - found[n].t_ns for n in range(39)} == {20_000_000}
    assert camera.dropped == 0
    described = camera.describe()
    assert {
        key: described[key]
        for key in ("exposure", "exposure_lock", "white_balance_lock", "time_stamps", "gain")
    } == {
        "exposure": "locked at 4000 us",
        "exposure_lock": "locked",
        "white_balance_lock": "locked",
        "time_stamps": "sensor",
        "gain": 2.0,
    }
    assert described["fps_measured"] == pytest.approx(50, rel=0.01)


def test_a_clock_that_was_set_to_1970_gives_no_time_before_it(
    stand_in: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    assert [frame.wall_ns for frame in frames(source(), 2)] == [0, 0]


def test_frames_that_are_skipped_are_counted_on(stand_in: Callable[..., None]) -> None:
    stand_in(lose=[30, 31, 35])
    camera = source()
    camera.open()
    try:
        assert all(camera.skip() for _ in range(38))
        frame = camera.read()
    finally:
        camera.close()
    assert frame is not None
    np.testing.assert_array_equal(frame.image, IMAGES[41 % len(IMAGES)])
    assert (frame.seq, camera.dropped) == (41, 3)


def test_lost_frames_are_counted_and_a_reopened_camera_counts_on(
    stand_in: Callable[..., None],
) -> None:
    stand_in(lose=[30, 31, 35])
    camera = source()
    first = frames(camera, 40)
    assert camera.dropped == 3
    assert first[-1].seq == 42
    stand_in()
    assert frames(camera, 2)[0].seq == 43


def test_first_frames_of_another_exposure_are_passed_over(stand_in: Callable[..., None]) -> None:
    stand_in(settle=3)
    np.testing.assert_array_equal(frames(source(fps=10), 1)[0].image, IMAGES[3])


@pytest.mark.parametrize(
    ("does", "code", "said"),
    [
        (
            {"says": "ERROR: *** no cameras available ***"},
            ReasonCode.ABSENT,
            "exited with status 255: 'no cameras available'",
        ),
        (
            {"says": "ERROR: *** failed to acquire camera /base/x ***"},
            ReasonCode.IN_USE,
            "failed to acquire",
        ),
        (
            {"count": 1, "exposure": 2},
            ReasonCode.LOST,
            "the program exited with status 0: 'no output'",
        ),
    ],
)
def test_a_program_that_ends_is_quoted(
    stand_in: Callable[..., None], does: dict[str, Any], code: ReasonCode, said: str
) -> None:
    stand_in(**does)
    with pytest.raises(DeviceError, match=said) as caught:
        source().open()
    assert caught.value.code is code


@pytest.mark.parametrize(
    ("does", "said"),
    [
        (
            {"exposure": 0.5},
            "requested an exposure of 4000 us and a gain of 2, but got 2000 us and 2",
        ),
        (
            {"extra_bytes": 512},
            r"found frames of another size, expected frames of 4608 bytes \(64x48 YUV\)",
        ),
        (
            {"extra_bytes": -512},
            r"found frames of another size, expected frames of 4608 bytes \(64x48 YUV\)",
        ),
        # Nine of its frames are eight of ours, read before it describes the ninth.
        (
            {"extra_bytes": -512, "behind": 9},
            r"found frames of another size, expected frames of 4608 bytes \(64x48 YUV\)",
        ),
    ],
)
def test_what_a_camera_does_not_offer_is_a_mistake_until_it_once_worked(
    stand_in: Callable[..., None], does: dict[str, Any], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rpicam, "_SETTLING", 8)
    camera = source()
    stand_in(**does)
    with pytest.raises(ConfigError, match=said):
        camera.open()
    stand_in()
    assert len(frames(camera, 1)) == 1
    stand_in(**does)
    with pytest.raises(DeviceError, match=said):
        camera.open()


@pytest.mark.parametrize("does", [{"stalls": 3}, {"records": False}])
def test_a_stall_is_reported_and_ended(
    stand_in: Callable[..., None], does: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rpicam, "_STALL_S", 0.3)
    monkeypatch.setattr(rpicam, "_START_S", patience(1.0))
    stand_in(**does)
    with pytest.raises((DeviceError, ConfigError)) as caught:
        frames(source(), 9)
    assert caught.value.code is (ReasonCode.STALLED if "stalls" in does else ReasonCode.NOT_OFFERED)


def test_no_program(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(
        DeviceError, match=r"no such program, expected that of Debian's package rpicam-apps-lite"
    ) as caught:
        source().open()
    assert caught.value.code is ReasonCode.ABSENT


@pytest.mark.parametrize(("asked", "found"), [(None, 1), (12.5, 12.5)])
def test_a_lens_that_moves_is_locked(
    stand_in: Callable[..., None], tmp_path: Path, asked: float | None, found: float
) -> None:
    stand_in(lens=True, notes=str(tmp_path / "arguments.json"))
    camera = RpicamSource(0, W, H, 50, 4000, 2.0, lens_position=asked, sensor_mode="1640:1232")
    frames(camera, 1)
    described = camera.describe()
    assert (described["focus"], described["focus_lock"]) == (
        f"locked at {found:g} dioptres",
        "locked",
    )
    assert json.loads((tmp_path / "arguments.json").read_text())["mode"] == "1640:1232"
