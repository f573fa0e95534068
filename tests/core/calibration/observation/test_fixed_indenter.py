from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.calibration.observation.fixed_indenter import Touch, fixed_indenter
from tacshade_edge.rigid import Rigid, shift, turn

R_MM = 20.0
angles = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
places = st.tuples(*[st.floats(-500.0, 500.0)] * 3)
touches = st.builds(Touch, st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(0.1, 6.0))


@given(angles, places, touches, st.sampled_from((0.0, 3.0, 9.0)))
def test_the_press_that_told_the_place_is_found_again(
    angle: tuple[float, ...], at: tuple[float, ...], told: Touch, radius_mm: float
) -> None:
    held = shift(*at) @ turn(angle)
    found = fixed_indenter(held, told, radius_mm, R_MM)
    again = found.touch(held, R_MM)
    assert (again.x_mm, again.y_mm, again.depth_mm) == pytest.approx((told.x_mm, told.y_mm, told.depth_mm), abs=1e-9)
    assert found.turned_deg(held) == pytest.approx(0.0, abs=1e-5)


@given(angles, places, st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.floats(0.0, 2.0))
def test_a_sensor_that_is_moved_along_its_own_axes(
    angle: tuple[float, ...], at: tuple[float, ...], x_mm: float, y_mm: float, deeper_mm: float
) -> None:
    """The indenter goes the other way in the sensor frame; the depth grows by what the skin falls off there."""
    held = shift(*at) @ turn(angle)
    told = Touch(1.0, -2.0, 2.5)
    moved = held @ shift(-x_mm, -y_mm, deeper_mm)
    found = fixed_indenter(held, told, 3.0, R_MM).touch(moved, R_MM)
    skin = [math.sqrt(R_MM**2 - x * x - y * y) for x, y in ((1.0, -2.0), (1.0 + x_mm, -2.0 + y_mm))]
    wanted = (1.0 + x_mm, -2.0 + y_mm, 2.5 + deeper_mm + skin[1] - skin[0])
    assert (found.x_mm, found.y_mm, found.depth_mm) == pytest.approx(wanted, abs=1e-9)


@given(angles.filter(lambda v: math.hypot(*v) > 0.01))
def test_a_ball_about_whose_centre_the_sensor_turns_keeps_its_centre(angle: tuple[float, ...]) -> None:
    """It lies on the line through the skin's centre: whatever way that points, the ball is as far from it."""
    told = Touch(0.0, 0.0, 2.0)
    found = fixed_indenter(shift(0.0, 0.0, 0.0), told, 4.0, R_MM)
    assert found.point_mm == pytest.approx((0.0, 0.0, R_MM - 2.0 + 4.0))
    tilted = turn(np.asarray(angle) * min(1.0, 0.4 / math.hypot(*angle)))
    seen = found.touch(tilted, R_MM)
    centre_mm = (seen.x_mm, seen.y_mm, math.sqrt(R_MM**2 - seen.x_mm**2 - seen.y_mm**2) - seen.depth_mm + 4.0)
    assert np.linalg.norm(centre_mm) == pytest.approx(R_MM + 2.0)
    assert found.turned_deg(tilted) == pytest.approx(math.degrees(min(0.4, math.hypot(*angle))), abs=1e-4)


def test_beside_the_skin() -> None:
    with pytest.raises(ValueError, match=r"x 21\.0, y 0\.0 mm lies outside a skin of radius 20 mm"):
        fixed_indenter(Rigid(np.eye(3), np.zeros(3)), Touch(21.0, 0.0, 1.0), 3.0, R_MM)
