from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.bumpy_surface import APEX_MM
from support.flange_plan import Turns, exact_frames
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid, of_pose, shift, turn
from tacshade_edge.robot.pose_buffer import (
    EXTRAPOLATION_MAX_NS,
    GAP_MAX_NS,
    HISTORY_NS,
    PoseBuffer,
    interpolate,
)
from tacshade_edge.stitching.flange import (
    ORDER,
    ContactFrame,
    FoundFlange,
    delay_seen,
    find_flange,
    unseen,
)
from tacshade_edge.types import F64, Pose

TRUE = shift(12, -7, 55) @ turn((0.3, -0.2, 1.1))
START = shift(6, 6, -5) @ Rigid(
    turn((0.1, -0.1, 0.1)).rotation @ TRUE.rotation, TRUE.translation_mm
)
DELAY_MS = 45.0
ONE = (((0, 0, 0),) * 5,)
YAWS = (((0, 0, 0), (90, 0, 0), (-90, 0, 0), (45, 0, 0), (-45, 0, 0)),)


def off(found: FoundFlange) -> F64:
    turned, _ = cv2.Rodrigues(found.flange_T_sensor.rotation @ TRUE.rotation.T)
    moved_mm = found.flange_T_sensor.translation_mm - TRUE.translation_mm
    return np.concatenate((moved_mm, np.degrees(turned.ravel()), (found.delay_ms - DELAY_MS,)))


@pytest.mark.slow
def test_the_plan_finds_it_from_ten_millimetres_and_ten_degrees_wherever_the_base_is() -> None:
    # The surface hangs on a wall a metre away.
    base = shift(1000, -500, 30) @ turn((0, 1.5, 0.8))

    def there(pose: Pose) -> Pose:
        return Pose(pose.t_ns, *(base @ of_pose(pose)).seven())

    hung = [
        replace(frame, track=tuple(map(there, frame.track)))
        for frame in exact_frames(TRUE, DELAY_MS)
    ]
    found = find_flange(hung, START, APEX_MM)
    error, sigma = off(found), np.sqrt(np.diag(found.covariance))
    assert np.linalg.norm(error[:3]) < 0.3
    assert np.linalg.norm(error[3:6]) < 0.5
    assert abs(error[6]) < 3
    assert (np.abs(error) < 2.5 * sigma).all()
    assert delay_seen(found)
    assert unseen(found) == ""
    assert found.left_mm < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("turns", "names"), [(ONE, "translation along x, y, z"), (YAWS, "translation along z")]
)
def test_a_motion_that_is_missing_is_named_and_nothing_said_of_the_delay(
    turns: Turns, names: str
) -> None:
    # The sensor's axes are the flange's here, so that the names are those of the plan.
    start = Rigid(np.eye(3), np.array((1.0, 2.0, 50.0)))
    found = find_flange(exact_frames(start, 0.0, turns, moving=False)[:20], start, APEX_MM)
    assert unseen(found).startswith(names)
    assert not delay_seen(found)
    assert np.sqrt(found.covariance[-1, -1]) == pytest.approx(100)
    assert ORDER[-1] == "delay_ms"


def test_presses_of_one_point_in_one_place_show_nothing() -> None:
    point, pose = np.array(((0.0, 0.0, 20.0, 1.0),)), Pose(0, 0, 0, 0, 0, 1, 0, 0)
    found = find_flange(
        [ContactFrame(point, k, 0, (pose,)) for k in range(12)], shift(0, 0, 0), APEX_MM
    )
    assert np.isfinite(found.covariance).all()
    assert unseen(found).startswith(
        "translation along x, y, z; rotation about x, y, z cannot be determined"
    )


def test_presses_from_opposite_sides_are_refused() -> None:
    point = np.array(((0.0, 0.0, 20.0, 1.0),))
    both = (Pose(0, 0, 0, 0, 0, 1, 0, 0), Pose(0, 0, 0, 0, 1, 0, 0, 0))
    with pytest.raises(ConfigError, match="face in opposite directions"):
        find_flange(
            [ContactFrame(point, k, 0, (both[k % 2],)) for k in range(12)], shift(0, 0, 0), APEX_MM
        )


MS = 10**6
UNITS = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 0.01)


def turned(t_ns: int, degrees: float, x_mm: float = 0.0, sign: float = 1.0) -> Pose:
    half = math.radians(degrees) / 2
    return Pose(t_ns, x_mm, 0.0, 0.0, sign * math.cos(half), 0.0, 0.0, sign * math.sin(half))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("degrees", [0.001, 1.0, 90.0, 179.0])
def test_half_way_is_half_the_way_and_half_the_turn(degrees: float, sign: float) -> None:
    a, b = turned(100, 0.0, 10.0), turned(200, degrees, 20.0, sign)
    for t_ns, part in ((100, 0.0), (150, 0.5), (175, 0.75), (200, 1.0), (220, 1.2)):
        found = interpolate(a, b, t_ns)
        expected = turned(t_ns, part * degrees, 10 + 10 * part)
        assert (found.t_ns, found.x_mm) == (t_ns, pytest.approx(expected.x_mm))
        assert [found.qw, found.qz] == pytest.approx([expected.qw, expected.qz], abs=1e-9)


@given(UNITS, st.floats(-500, 500), st.lists(st.integers(-50, 150), min_size=2, max_size=5))
def test_a_robot_at_rest_is_at_one_place_to_the_last_bit(
    q: tuple[float, ...], x_mm: float, times_ns: list[int]
) -> None:
    a, b = (Pose(t_ns, x_mm, -x_mm / 3, 0.1, *q) for t_ns in (0, 100))
    assert len({replace(interpolate(a, b, t_ns), t_ns=0) for t_ns in times_ns}) == 1


@given(UNITS, UNITS, st.integers(-50, 150))
def test_a_quaternion_stays_a_unit(q: tuple[float, ...], r: tuple[float, ...], t_ns: int) -> None:
    a, b = (
        Pose(t, 0.0, 0.0, 0.0, *(v / math.hypot(*values) for v in values))
        for t, values in ((0, q), (100, r))
    )
    found = interpolate(a, b, t_ns)
    assert math.hypot(found.qw, found.qx, found.qy, found.qz) == pytest.approx(1)


def filled(*times_ms: int) -> PoseBuffer:
    buffer = PoseBuffer()
    for t_ms in times_ms:
        buffer.add(turned(t_ms * MS, t_ms / 10, t_ms))
    return buffer


def test_between_two_poses() -> None:
    buffer = filled(100, 110, 120)
    for t_ms in (100, 103, 110, 118, 120):
        found = buffer.at(t_ms * MS)
        assert found is not None
        assert (found.pose.t_ns, found.extrapolated_ns) == (t_ms * MS, 0)
        assert found.pose.x_mm == pytest.approx(t_ms)


def test_never_far_beyond_nor_before_nor_over_a_gap() -> None:
    assert filled(100).at(100 * MS) is None
    buffer = filled(100, 110)
    beyond = buffer.at(110 * MS + EXTRAPOLATION_MAX_NS)
    assert beyond is not None
    assert (beyond.extrapolated_ns, beyond.pose.x_mm) == (EXTRAPOLATION_MAX_NS, pytest.approx(130))
    assert buffer.at(110 * MS + EXTRAPOLATION_MAX_NS + 1) is None
    assert buffer.at(100 * MS - 1) is None
    buffer.add(turned(110 * MS + GAP_MAX_NS + 1, 0.0))
    assert buffer.at(200 * MS) is None
    assert buffer.at(110 * MS) is not None
    assert buffer.at(110 * MS + GAP_MAX_NS + 1) is not None
    assert buffer.at(110 * MS + GAP_MAX_NS + 2) is None  # nothing shows how it moves


def test_poses_that_come_late_or_again_are_counted_and_left_out() -> None:
    buffer = filled(100, 110, 110, 105, 120)
    assert buffer.late == 2
    found = buffer.at(107 * MS)
    assert found is not None
    assert found.pose.x_mm == pytest.approx(107)
    buffer.clear()
    assert buffer.at(107 * MS) is None


def test_old_poses_go() -> None:
    buffer = filled(*range(0, 2 * HISTORY_NS // MS, 10))
    assert buffer.at(HISTORY_NS - 20 * MS) is None
    assert buffer.at(HISTORY_NS + 20 * MS) is not None
