from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.calibration.indenters import box, cylinder
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.machine import (
    Touch,
    first_touch_mm,
    fixed_indenter,
    from_travel,
)
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid, shift, turn

R_MM = 20.0
angles = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
places = st.tuples(*[st.floats(-500.0, 500.0)] * 3)
TOUCHES = st.builds(Touch, st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(0.1, 6.0))


@given(st.floats(0, 12), st.floats(1, 10))
def test_a_ball_touches_before_its_lowest_point_is_at_the_skin(x_mm: float, ball_mm: float) -> None:
    depth_mm = first_touch_mm(ball_mm, 20.0, x_mm, 0.0)
    centre = np.array((x_mm, math.sqrt(400 - x_mm**2) - depth_mm + ball_mm))
    assert float(np.hypot(*centre)) == pytest.approx(20 + ball_mm)


def test_flat_ends_touch_beside_their_middle() -> None:
    assert first_touch_mm(cylinder("flat", 4), 20, 0, 0) == pytest.approx(0, abs=1e-6)
    assert first_touch_mm(cylinder("flat", 4), 20, 6, 0) == pytest.approx(
        math.sqrt(400 - 36) - math.sqrt(400 - 4), abs=1e-3
    )
    turned = first_touch_mm(box("square", 8, 4), 20, 6, 0, 90), first_touch_mm(box("square", 8, 4), 20, 6, 0)
    assert turned[0] == pytest.approx(math.sqrt(400 - 36) - math.sqrt(400 - 16), abs=1e-3)
    assert turned[1] < turned[0]


def test_travel_becomes_depth() -> None:
    image = np.zeros((2, 2), np.uint8)
    ball = KnownPress("ball", image, 6.0, 2.0, 6.0, 0.0)
    assert from_travel(ball, 20).depth_mm == pytest.approx(2 + first_touch_mm(6.0, 20, 6, 0))
    flat = KnownPress("flat", image, 0.0, 2.0, 6.0, 0.0, cylinder("flat", 4), tilt_x_deg=5.0)
    upright = KnownPress("flat", image, 0.0, 2.0, 6.0, 0.0, cylinder("flat", 4))
    assert from_travel(upright, 20).depth_mm == pytest.approx(2 + first_touch_mm(cylinder("flat", 4), 20, 6, 0))
    assert from_travel(flat, 20).depth_mm != pytest.approx(from_travel(upright, 20).depth_mm, abs=0.01)
    with pytest.raises(ConfigError, match="ball: x_mm, y_mm: found no values"):
        from_travel(KnownPress("ball", image, 6.0, 2.0, None, None), 20)
    with pytest.raises(ConfigError, match="expected a place within the skin"):
        from_travel(KnownPress("ball", image, 6.0, 2.0, 30.0, 0.0), 20)


@given(angles, places, TOUCHES, st.sampled_from((0.0, 3.0, 9.0)))
def test_the_press_that_told_the_place_is_found_again(
    angle: tuple[float, ...], at: tuple[float, ...], reported: Touch, radius_mm: float
) -> None:
    held = shift(*at) @ turn(angle)
    found = fixed_indenter(held, reported, radius_mm, R_MM)
    again = found.touch(held, R_MM)
    assert (again.x_mm, again.y_mm, again.depth_mm) == pytest.approx(
        (reported.x_mm, reported.y_mm, reported.depth_mm), abs=1e-9
    )
    assert found.turned_deg(held) == pytest.approx(0.0, abs=1e-5)


@given(angles, places, st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.floats(0.0, 2.0))
def test_a_sensor_that_is_moved_along_its_own_axes(
    angle: tuple[float, ...], at: tuple[float, ...], x_mm: float, y_mm: float, deeper_mm: float
) -> None:
    """The indenter goes the other way in the sensor frame; the depth grows by what the skin falls off there."""
    held = shift(*at) @ turn(angle)
    reported = Touch(1.0, -2.0, 2.5)
    moved = held @ shift(-x_mm, -y_mm, deeper_mm)
    found = fixed_indenter(held, reported, 3.0, R_MM).touch(moved, R_MM)
    skin = [math.sqrt(R_MM**2 - x * x - y * y) for x, y in ((1.0, -2.0), (1.0 + x_mm, -2.0 + y_mm))]
    wanted = (1.0 + x_mm, -2.0 + y_mm, 2.5 + deeper_mm + skin[1] - skin[0])
    assert (found.x_mm, found.y_mm, found.depth_mm) == pytest.approx(wanted, abs=1e-9)


@given(angles.filter(lambda v: math.hypot(*v) > 0.01))
def test_a_ball_about_whose_centre_the_sensor_turns_keeps_its_centre(angle: tuple[float, ...]) -> None:
    """It lies on the line through the skin's centre: whatever way that points, the ball is as far from it."""
    reported = Touch(0.0, 0.0, 2.0)
    found = fixed_indenter(shift(0.0, 0.0, 0.0), reported, 4.0, R_MM)
    assert found.point_mm == pytest.approx((0.0, 0.0, R_MM - 2.0 + 4.0))
    tilted = turn(np.asarray(angle) * min(1.0, 0.4 / math.hypot(*angle)))
    seen = found.touch(tilted, R_MM)
    centre_mm = (seen.x_mm, seen.y_mm, math.sqrt(R_MM**2 - seen.x_mm**2 - seen.y_mm**2) - seen.depth_mm + 4.0)
    assert np.linalg.norm(centre_mm) == pytest.approx(R_MM + 2.0)
    assert found.turned_deg(tilted) == pytest.approx(math.degrees(min(0.4, math.hypot(*angle))), abs=1e-4)


def test_beside_the_skin() -> None:
    with pytest.raises(ValueError, match=r"x 21\.0, y 0\.0 mm lies outside a skin of radius 20 mm"):
        fixed_indenter(Rigid(np.eye(3), np.zeros(3)), Touch(21.0, 0.0, 1.0), 3.0, R_MM)
