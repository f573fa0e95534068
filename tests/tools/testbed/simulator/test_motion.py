import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tools.testbed.simulator.motion import CLEAR_MM, Motion, pressed

BALL = ball(5.0)
WAY = (
    pressed(Press(BALL, 1.0, -2.0, 3.0), 1.0, 10.0).held(2.0).dragged(3.0, 4.0, 5.0).twisted(-20.0, 40.0).released(20.0)
)


def test_a_way_is_its_knots_and_straight_between_them() -> None:
    assert WAY.times_s == pytest.approx([1.0, 1.1, 1.4, 3.4, 4.4, 4.9, 5.05, 5.1])
    assert WAY.at(0.99) is None
    assert WAY.at(5.11) is None
    at = {t: WAY.at(t) for t in (1.25, 2.0, 3.9, 4.65, 5.1)}
    assert at[1.25] is not None
    assert at[1.25].depth_mm == pytest.approx(1.5)
    assert at[2.0] == Press(BALL, 1.0, -2.0, 3.0)
    assert at[3.9] is not None
    assert (at[3.9].x_mm, at[3.9].y_mm) == pytest.approx((2.5, 0.0))
    assert (at[3.9].drag_x_mm, at[3.9].drag_y_mm) == pytest.approx((1.5, 2.0))
    assert at[4.65] is not None
    assert (at[4.65].twist_deg, at[4.65].rotation_deg) == pytest.approx((-10.0, -10.0))
    assert at[5.1] is not None
    assert at[5.1].depth_mm == pytest.approx(-CLEAR_MM)


def test_its_velocity() -> None:
    (vx, vy, vz), turn = WAY.velocity(2.0, 20.0)
    assert (vx, vy, vz, turn) == (0, 0, 0, 0)
    assert WAY.velocity(1.2, 20.0)[0] == pytest.approx((0, 0, -10.0))
    (vx, vy, vz), turn = WAY.velocity(3.9, 20.0)
    assert (vx, vy, turn) == pytest.approx((3.0, 4.0, 0.0))
    assert vz == pytest.approx(-3.0 * 2.5 / math.sqrt(400 - 2.5**2), rel=1e-3)  # it keeps its depth on the sphere
    assert WAY.velocity(4.5, 20.0)[1] == pytest.approx(-40.0)
    assert WAY.velocity(9.0, 20.0) == ((0, 0, 0), 0)


@given(st.floats(0.2, 5.0))
def test_steps_are_no_longer_than_asked_and_hold_every_knot(step_mm: float) -> None:
    times = WAY.steps_s(step_mm)
    assert set(WAY.times_s) <= set(times)
    assert list(times) == sorted(set(times))
    places = [WAY.at(t) for t in times]
    for one, other in pairwise(places):
        assert one is not None
        assert other is not None
        moved = math.dist((one.x_mm, one.y_mm, one.depth_mm), (other.x_mm, other.y_mm, other.depth_mm))
        assert moved <= step_mm + 1e-6


@pytest.mark.parametrize(
    ("times", "shapes", "message"),
    [
        ((0.0,), (BALL,), "expected two or more"),
        ((0.0, 1.0), (BALL,), "expected two or more"),
        ((0.0, 0.0), (BALL, BALL), "expected increasing"),
        ((0.0, math.inf), (BALL, BALL), "expected increasing"),
        ((0.0, 1.0), (BALL, ball(4.0)), "expected one object"),
    ],
)
def test_what_is_no_way_is_refused(times: tuple[float, ...], shapes: tuple, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Motion(times, tuple(Press(shape) for shape in shapes))
