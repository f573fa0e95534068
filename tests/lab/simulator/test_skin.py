import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.lab.simulator.press import OBJECTS, Press, Shape, ball, distance_mm
from tacshade_edge.lab.simulator.sensor_model import RIM_HALF_ANGLE_DEG
from tacshade_edge.lab.simulator.skin import (
    Skin,
    chart_to_direction,
    direction_to_chart,
    mass_weight,
    press_skin,
    undeformed,
)
from tacshade_edge.types import F64

R_MM, DECAY_MM = 20.0, 2.2


def complementarity_residual_mm(skin: Skin, decay_mm: float) -> F64:
    """min(h - obstacle, net pull / diagonal) at the inner nodes:
    0 everywhere at the exact solution.
    """
    h = skin.height_mm.astype(np.float64)
    mass = (
        mass_weight(skin.radius_mm, skin.step_mm, h.shape[0] // 2)[1:-1, 1:-1]
        * (skin.step_mm / decay_mm) ** 2
    )
    neighbours = h[:-2, 1:-1] + h[2:, 1:-1] + h[1:-1, :-2] + h[1:-1, 2:]
    pull = h[1:-1, 1:-1] - neighbours / (4 + mass)
    return np.asarray(np.minimum(h[1:-1, 1:-1] - skin.obstacle_mm[1:-1, 1:-1], pull))


@pytest.mark.parametrize("name", OBJECTS)
def test_solution_satisfies_the_complementarity_conditions(name: str) -> None:
    skin = press_skin(R_MM, DECAY_MM, [Press(OBJECTS[name](), 1.0, -2.0, 3.0, 20.0)])
    assert skin.height_mm.max() > 1.0
    assert np.min(skin.height_mm - skin.obstacle_mm) >= 0
    assert np.abs(complementarity_residual_mm(skin, DECAY_MM)).max() < 2e-4


@pytest.mark.parametrize("depth_mm", [0.2, 1.0, 3.0, 6.0])
def test_a_ball_at_the_apex_is_as_deep_as_it_was_pressed(depth_mm: float) -> None:
    skin = press_skin(R_MM, DECAY_MM, [Press(ball(5.0), 0.0, 0.0, depth_mm)])
    centre = skin.sample(np.zeros(1), np.zeros(1))[0]
    assert centre == pytest.approx(depth_mm, abs=1e-3)
    assert skin.height_mm.max() == pytest.approx(depth_mm, abs=1e-3)


@pytest.mark.parametrize("decay_mm", [1.5, 3.0])
def test_skirt_decays_over_the_given_length(decay_mm: float) -> None:
    # A ridge along x, far longer than the decay:
    # across it the membrane is one-dimensional, h ~ exp(-y / λ).
    ridge = Shape("ridge", lambda p: np.hypot(p[:, 1], p[:, 2] - 0.5) - 0.5)
    skin = press_skin(R_MM * 3, decay_mm, [Press(ridge, 0.0, 0.0, 1.0)])
    y = np.array([3.0, 3.0 + decay_mm])
    near, far = skin.sample(np.zeros(2), y)
    assert near / far == pytest.approx(math.e, rel=0.08)


def test_no_press_and_a_press_that_does_not_reach_leave_the_skin_alone() -> None:
    assert not press_skin(R_MM, DECAY_MM, []).height_mm.any()
    assert not press_skin(R_MM, DECAY_MM, [Press(ball(5.0), 2.0, 0.0, -1.0)]).height_mm.any()
    assert not undeformed(R_MM).height_mm.any()


@pytest.mark.slow
@given(
    name=st.sampled_from(sorted(OBJECTS)),
    x_mm=st.floats(-13, 13),
    y_mm=st.floats(-13, 13),
    depth_mm=st.floats(-1, 8),
    rotation_deg=st.floats(-360, 360),
)
@settings(max_examples=25, deadline=None)
def test_any_press_gives_a_finite_skin_outside_the_object(
    name: str, x_mm: float, y_mm: float, depth_mm: float, rotation_deg: float
) -> None:
    press = Press(OBJECTS[name](), x_mm, y_mm, depth_mm, rotation_deg)
    try:
        skin = press_skin(R_MM, DECAY_MM, [press])
    except ValueError as error:
        # Only some presses may be refused.
        assert "reaches the sensor's centre" in str(error)  # noqa: PT017
        assert distance_mm([press], R_MM, np.zeros((1, 3)))[0] < 0.1 * R_MM
        return
    assert np.isfinite(skin.height_mm).all()
    assert skin.height_mm.min() >= 0
    i, j = np.nonzero(skin.height_mm > 0)
    n = skin.height_mm.shape[0] // 2
    points = chart_to_direction((j - n) * skin.step_mm, (i - n) * skin.step_mm, R_MM)
    skin_only = points[:, 2] > math.cos(
        math.radians(RIM_HALF_ANGLE_DEG)
    )  # beyond, it is the housing
    points = (points * (R_MM - skin.height_mm[i, j])[:, None])[skin_only]
    if len(points):
        assert distance_mm([press], R_MM, points).min() > -0.01


def test_press_beside_the_skin_and_through_the_middle_are_refused() -> None:
    with pytest.raises(ValueError, match="not over the skin"):
        press_skin(R_MM, DECAY_MM, [Press(ball(), 19.0, 9.0, 1.0)])
    with pytest.raises(ValueError, match="reaches the sensor's centre"):
        press_skin(R_MM, DECAY_MM, [Press(ball(), 0.0, 0.0, 19.0)])


@given(st.floats(-25, 25), st.floats(-25, 25))
def test_chart_and_direction_are_inverse(x: float, y: float) -> None:
    direction = chart_to_direction(np.array([x]), np.array([y]), R_MM)
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    back = direction_to_chart(3.0 * direction, R_MM)
    assert (back[0][0], back[1][0]) == (pytest.approx(x, abs=1e-9), pytest.approx(y, abs=1e-9))
