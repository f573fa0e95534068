import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.rigid import from_seven, turn, turned_rad

numbers = st.floats(-1, 1)
poses = st.tuples(*[st.floats(-500, 500)] * 3, *[numbers] * 4).filter(lambda v: math.hypot(*v[3:]) > 0.1)


@given(poses)
def test_seven_numbers_come_back(values: tuple[float, ...]) -> None:
    pose = from_seven(values)
    again = from_seven(pose.seven())
    np.testing.assert_allclose(again.rotation, pose.rotation, atol=1e-12)
    np.testing.assert_allclose(again.translation_mm, values[:3], atol=1e-12)
    assert math.hypot(*pose.seven()[3:]) == pytest.approx(1)
    assert pose.seven()[3] >= 0


@given(poses, poses)
def test_composition_applies_the_inner_one_first(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    outer, inner = from_seven(a), from_seven(b)
    points = np.array(((0.0, 0.0, 20.0), (3.0, -4.0, 5.0)))
    np.testing.assert_allclose((outer @ inner).apply(points), outer.apply(inner.apply(points)), atol=1e-9)
    np.testing.assert_allclose(outer.inverse().apply(outer.apply(points)), points, atol=1e-9)


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (1e-9, 0.0, 0.0), (0.0, math.pi, 0.0), (0.3, -0.4, 0.5)])
def test_a_turn_is_the_quaternions(vector: tuple[float, float, float]) -> None:
    angle = math.hypot(*vector)
    axis = np.array(vector) / angle if angle else np.array((1.0, 0.0, 0.0))
    expected = from_seven((0.0, 0.0, 0.0, math.cos(angle / 2), *(math.sin(angle / 2) * axis)))
    np.testing.assert_allclose(turn(vector).rotation, expected.rotation, atol=1e-12)


@given(st.tuples(numbers, numbers, numbers), st.floats(0, math.pi - 1e-3))
def test_a_turn_gives_its_vector_back(axis: tuple[float, float, float], angle: float) -> None:
    size = math.hypot(*axis)
    vector = np.array(axis) * (angle / size if size > 1e-3 else 0.0)
    np.testing.assert_allclose(turned_rad(turn(vector).rotation), vector, atol=1e-9)


def test_no_rotation_is_refused() -> None:
    with pytest.raises(ValueError, match="length 0"):
        from_seven((0.0,) * 7)
