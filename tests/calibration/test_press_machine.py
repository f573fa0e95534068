from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.calibration.indenters import Indenter, box, cylinder, place
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.press_machine import TouchPoint, fixed_indenter, from_travel
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid, shift, turn

R_MM = 20.0
angles = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
places = st.tuples(*[st.floats(-500.0, 500.0)] * 3)
TOUCHES = st.builds(TouchPoint, st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(0.1, 6.0))


def first_touch_mm(indenter: Indenter, x_mm: float, yaw_deg: float = 0.0) -> float:
    return place(indenter, R_MM, x_mm, 0.0, R_MM / 2, yaw_deg).first_touch_mm(R_MM)


def test_flat_ends_touch_beside_their_middle() -> None:
    flat, square = cylinder("flat", 4), box("square", 8, 4)
    assert first_touch_mm(flat, 0) == pytest.approx(0, abs=1e-6)
    assert first_touch_mm(flat, 6) == pytest.approx(
        math.sqrt(400 - 36) - math.sqrt(400 - 4), abs=1e-3
    )
    assert first_touch_mm(square, 6, 90) == pytest.approx(
        math.sqrt(400 - 36) - math.sqrt(400 - 16), abs=1e-3
    )
    assert first_touch_mm(square, 6) < first_touch_mm(square, 6, 90)


def test_travel_becomes_depth() -> None:
    image = np.zeros((2, 2), np.uint8)
    ball = from_travel(KnownPress("ball", image, 6.0, 0.0, 6.0, 0.0), 20)
    assert math.hypot(6.0, math.sqrt(400 - 36) - ball.depth_mm + 6.0) == pytest.approx(26.0)
    flat = KnownPress("flat", image, 0.0, 2.0, 6.0, 0.0, cylinder("flat", 4), tilt_x_deg=5.0)
    upright = KnownPress("flat", image, 0.0, 2.0, 6.0, 0.0, cylinder("flat", 4))
    assert from_travel(upright, 20).depth_mm == pytest.approx(
        2 + first_touch_mm(cylinder("flat", 4), 6)
    )
    assert from_travel(flat, 20).depth_mm != pytest.approx(
        from_travel(upright, 20).depth_mm, abs=0.01
    )
    with pytest.raises(ConfigError, match="ball: x_mm, y_mm: found no values"):
        from_travel(KnownPress("ball", image, 6.0, 2.0, None, None), 20)
    with pytest.raises(ConfigError, match="expected a place within the skin"):
        from_travel(KnownPress("ball", image, 6.0, 2.0, 30.0, 0.0), 20)


@given(angles, places, TOUCHES, st.sampled_from((0.0, 3.0, 9.0)))
def test_the_press_that_gave_the_place_is_found_again(
    angle: tuple[float, ...], at: tuple[float, ...], reported: TouchPoint, radius_mm: float
) -> None:
    held = shift(*at) @ turn(angle)
    found = fixed_indenter(held, reported, radius_mm, R_MM)
    again = found.touch(held, R_MM)
    assert (again.x_mm, again.y_mm, again.depth_mm) == pytest.approx(
        (reported.x_mm, reported.y_mm, reported.depth_mm), abs=1e-9
    )
    assert found.turned_deg(held) == pytest.approx(0.0, abs=1e-5)


@given(angles.filter(lambda v: math.hypot(*v) > 0.01))
def test_a_ball_about_whose_centre_the_sensor_turns_keeps_its_centre(
    angle: tuple[float, ...],
) -> None:
    """It lies on the line through the skin's centre:
    whatever way that points, the ball is as far from it.
    """
    reported = TouchPoint(0.0, 0.0, 2.0)
    found = fixed_indenter(shift(0.0, 0.0, 0.0), reported, 4.0, R_MM)
    assert found.point_mm == pytest.approx((0.0, 0.0, R_MM - 2.0 + 4.0))
    tilted = turn(np.asarray(angle) * min(1.0, 0.4 / math.hypot(*angle)))
    seen = found.touch(tilted, R_MM)
    centre_mm = (
        seen.x_mm,
        seen.y_mm,
        math.sqrt(R_MM**2 - seen.x_mm**2 - seen.y_mm**2) - seen.depth_mm + 4.0,
    )
    assert np.linalg.norm(centre_mm) == pytest.approx(R_MM + 2.0)
    assert found.turned_deg(tilted) == pytest.approx(
        math.degrees(min(0.4, math.hypot(*angle))), abs=1e-4
    )


def test_beside_the_skin() -> None:
    with pytest.raises(ValueError, match=r"x 21\.0, y 0\.0 mm lies outside a skin of radius 20 mm"):
        fixed_indenter(Rigid(np.eye(3), np.zeros(3)), TouchPoint(21.0, 0.0, 1.0), 3.0, R_MM)
