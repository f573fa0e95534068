"""A map judged by a known surface, the paper's average and the picture of both."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.lab.simulator import pad as pads
from tacshade_edge.lab.simulator.pad import Arc, Bar, Pad
from tacshade_edge.lab.studies.stitch import map_presses as contact_frames
from tacshade_edge.lab.studies.stitch.map_presses import (
    MapPress,
    frames_of_presses,
    read_contact_frames,
)
from tacshade_edge.lab.studies.stitch.map_truth import read_known, score
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import from_seven, of_pose, shift
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.stitching.press_points import NO_POINTS, PressPoints
from tacshade_edge.stitching.stitcher import Raster
from tacshade_edge.types import Pose

POINTS = PressPoints(
    np.array(((0, 0, 19), (1, 0, 19)), np.float32),
    np.ones((2, 3), np.float32),
    np.ones(2, np.float32),
)
MS = 1_000_000


def frame(t_ms: int, depth_mm: float | None, z_mm: float | None) -> SimpleNamespace:
    """A frame of a robot at a height; no contact at depth 0, touched at an unknown depth,
    no pose without a height.
    """
    pose = None if z_mm is None else Pose(0, 0, 0, z_mm, 1, 0, 0, 0)
    return SimpleNamespace(frame=SimpleNamespace(t_ns=t_ms * MS, pose=pose, depth_mm=depth_mm))


class FakeRecording:
    def __init__(self, frames: list[SimpleNamespace | DecodeError]) -> None:
        self._frames = iter(frames)

    def read(self) -> SimpleNamespace | None:
        recorded = next(self._frames, None)
        if isinstance(recorded, DecodeError):
            raise recorded
        return recorded


class FakeReconstructor:
    def step(self, given: Any) -> SimpleNamespace:
        depth_mm = given.depth_mm or 0.0
        return SimpleNamespace(
            t_ns=given.t_ns,
            valid=True,
            contact=depth_mm > 0,
            touched=given.depth_mm is None,
            depth_max_mm=depth_mm,
            height=None,
        )


@pytest.fixture(autouse=True)
def _fake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact_frames, "make_reconstructor", lambda *_: FakeReconstructor())
    monkeypatch.setattr(contact_frames, "press_points", lambda *_: POINTS)


def press_down_and_up(first_ms: int) -> list[SimpleNamespace | DecodeError]:
    """10 mm/s down to 2 mm, half a second of rest, up; 100 frames/s."""
    heights = [*np.arange(0.5, -2, -0.1), *[-2.0] * 50, *np.arange(-2, 0.5, 0.1)]
    return [frame(first_ms + 10 * k, max(0.0, -z), float(z)) for k, z in enumerate(heights)]


def read(frames: list[SimpleNamespace | DecodeError]) -> tuple[list[Any], list[Reason]]:
    return read_contact_frames(
        SimpleNamespace(geometry=None), PROFILES["fast"], FakeRecording(frames)
    )  # type: ignore[arg-type]


def test_a_frame_of_unknown_depth_is_no_press_and_ends_none() -> None:
    pressed = press_down_and_up(1000)
    lost = [frame(1000 + 10 * k + 5, None, -2.0) for k in range(30, 74, 7)]  # while it rests
    between = sorted([*pressed, *lost], key=lambda one: one.frame.t_ns)
    found, alone = (
        [(one.press, one.t_ns) for one in read(list(frames))[0]] for frames in (between, pressed)
    )
    assert found == alone


def test_a_press_has_a_frame_at_rest_and_some_of_its_motion() -> None:
    found, unread = read(press_down_and_up(1000) + press_down_and_up(5000))
    assert not unread
    assert [one.press for one in found] == [0] * 5 + [1] * 5
    rest, *moving = found[:5]
    assert len(rest.track) == 1
    assert rest.track[0].z_mm == -2
    down = [one for one in moving if one.t_ns < rest.t_ns]
    assert len(down) == 2
    for one in moving:
        times = [pose.t_ns for pose in one.track]
        assert times == sorted(set(times))
        assert times[0] < one.t_ns < times[-1]
        assert times[-1] - times[0] <= 600 * MS


def test_a_track_ends_at_a_gap() -> None:
    frames = press_down_and_up(1000)
    frames[:15] = [frame(1 + k, 0, 1.0) for k in range(15)]  # long before
    found, _ = read(frames)
    assert min(pose.t_ns for one in found for pose in one.track) == 1150 * MS


def test_frames_without_a_pose_are_none() -> None:
    found, unread = read([frame(10 * k, 2.0, None) for k in range(100)])
    assert found == unread == []


def test_a_frame_that_cannot_be_read_is_reported() -> None:
    found, unread = read([DecodeError("x.png: damaged"), *press_down_and_up(1000)])
    assert len(found) == 5
    assert [reason.text for reason in unread] == ["x.png: damaged"]


def test_presses_of_images_stand_still_at_the_flange() -> None:
    flange_T_sensor = from_seven((1, 2, 50, 0.8, 0, 0, 0.6))
    air = MapPress("b", "", shift(0, 0, 0), NO_POINTS, Reason(ReasonCode.NO_CONTACT, "no contact"))
    presses = [MapPress("a", "", shift(k, 0, 0) @ flange_T_sensor, POINTS, None) for k in range(3)]
    found = frames_of_presses([air, *presses], flange_T_sensor)
    assert [one.press for one in found] == [0, 1, 2]
    assert of_pose(found[2].track[0]).translation_mm == pytest.approx((2, 0, 0))


BAR, RING = Bar(5.1, 3.1, 5.1, 23.1, 3.0), Arc(20.1, 13.1, 7.0, 3.0)


def raster(*bulges: Bar | Arc, step_mm: float = 0.25) -> Raster:
    return Raster(pads.raster(Pad(32.0, 26.0, bulges), step_mm), 0.0, 0.0, step_mm)


KNOWN = raster(BAR, RING)


def test_the_truth_scores_best() -> None:
    s = score(KNOWN, KNOWN)
    assert (s.rms_mm, s.mean_mm, s.p95_mm, s.outside_cells, s.raised_coverage) == (0, 0, 0, 0, 1)
    assert s.covered_mm2 == pytest.approx(32 * 26, rel=0.03)


def test_errors_are_measured_where_something_was_touched() -> None:
    z = KNOWN.z_mm + np.float32(0.1)
    z[:40] = np.nan
    s = score(replace(KNOWN, z_mm=z), KNOWN)
    assert (s.rms_mm, s.mean_mm) == (pytest.approx(0.1, abs=1e-5), pytest.approx(0.1, abs=1e-5))
    assert s.covered_mm2 == pytest.approx(np.count_nonzero(np.isfinite(z)) / 16)
    assert 0.5 < s.raised_coverage < 0.9
    assert s.raised_mean_mm == pytest.approx(0.1, abs=1e-5)


def test_another_frame_is_reported() -> None:
    with pytest.raises(ConfigError, match="share no cell"):
        score(replace(KNOWN, x0_mm=500.0), KNOWN)


def test_a_file_of_the_contracts_keys_is_enough(tmp_path: Path) -> None:
    path = tmp_path / "map.npz"
    np.savez(path, z_mm=KNOWN.z_mm, x0_mm=0.0, y0_mm=0.0, step_mm=0.25)
    np.testing.assert_array_equal(read_known(path).z_mm, KNOWN.z_mm)


@pytest.mark.parametrize(
    "change",
    [
        {"z_mm": np.zeros(3)},
        {"step_mm": 0.0},
        {"z_mm": np.full((2, 2), np.nan)},
        {"z_mm": None},
        {"step_mm": np.inf},
        {"step_mm": 1e-300},
        {"x0_mm": np.nan},
        {"x0_mm": np.zeros(2)},
        {"z_mm": np.array("a")},
        {"z_mm": np.array([[None]])},
        {"z_mm": np.full((2, 2), 1e7)},
        {"z_mm": np.full((2, 2), 2**64 - 1, np.uint64)},
        {"z_mm": np.zeros((2048, 2049), bool)},
    ],
)
def test_a_map_that_is_none(tmp_path: Path, change: dict[str, object]) -> None:
    content = {"z_mm": np.zeros((4, 4)), "x0_mm": 0.0, "y0_mm": 0.0, "step_mm": 1.0} | change
    if content["z_mm"] is None:
        del content["z_mm"]
    np.savez(tmp_path / "bad.npz", **content)
    with pytest.raises(ConfigError, match=r"bad\.npz"):
        read_known(tmp_path / "bad.npz")


def test_a_damaged_and_a_missing_file(tmp_path: Path) -> None:
    (tmp_path / "bad.npz").write_bytes(b"no zip")
    for name, why in (("bad.npz", "no known surface"), ("none.npz", "No such file")):
        with pytest.raises(ConfigError, match=f"{name}: .*{why}"):
            read_known(tmp_path / name)
