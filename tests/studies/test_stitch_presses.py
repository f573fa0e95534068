from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.stitching.press_points import NO_POINTS, PressPoints
from tacshade_edge.errors import DecodeError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import from_seven, of_pose, shift
from tacshade_edge.studies.stitch import presses as contact_frames
from tacshade_edge.studies.stitch.presses import PRESSES_MAX, Press, frames_of_presses, read_contact_frames
from tacshade_edge.types import Pose

POINTS = PressPoints(
    np.array(((0, 0, 19), (1, 0, 19)), np.float32), np.ones((2, 3), np.float32), np.ones(2, np.float32)
)
MS = 1_000_000


def frame(t_ms: int, depth_mm: float, z_mm: float | None) -> SimpleNamespace:
    """A frame of a robot at a height; no contact at depth 0, no pose without a height."""
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
        depth_mm = given.depth_mm
        return SimpleNamespace(t_ns=given.t_ns, valid=True, contact=depth_mm > 0, depth_max_mm=depth_mm, height=None)


@pytest.fixture(autouse=True)
def _fake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact_frames, "make_reconstructor", lambda *_: FakeReconstructor())
    monkeypatch.setattr(contact_frames, "press_points", lambda *_: POINTS)


def press_down_and_up(first_ms: int) -> list[SimpleNamespace | DecodeError]:
    """10 mm/s down to 2 mm, half a second of rest, up; 100 frames/s."""
    heights = [*np.arange(0.5, -2, -0.1), *[-2.0] * 50, *np.arange(-2, 0.5, 0.1)]
    return [frame(first_ms + 10 * k, max(0.0, -z), float(z)) for k, z in enumerate(heights)]


def read(frames: list[SimpleNamespace | DecodeError]) -> tuple[list[Any], list[Reason]]:
    return read_contact_frames(SimpleNamespace(geometry=None), PROFILES["fast"], FakeRecording(frames))  # type: ignore[arg-type]


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
    air = Press("b", "", shift(0, 0, 0), NO_POINTS, Reason(ReasonCode.NO_CONTACT, "no contact"))
    presses = [Press("a", "", shift(k, 0, 0) @ flange_T_sensor, POINTS, None) for k in range(3)]
    found = frames_of_presses([air, *presses], flange_T_sensor)
    assert [one.press for one in found] == [0, 1, 2]
    assert of_pose(found[2].track[0]).translation_mm == pytest.approx((2, 0, 0))


def test_more_presses_than_it_takes_are_thinned_out() -> None:
    presses = [Press("a", "", shift(k, 0, 0), POINTS, None) for k in range(PRESSES_MAX + 1)]
    found = frames_of_presses(presses, shift(0, 0, 0))
    assert [one.track[0].x_mm for one in found] == list(range(0, PRESSES_MAX + 1, 2))
