from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.contact.margin import ALARM, LEAST_LIMIT, LIMIT, Grip
from tacshade_edge.types import Slip

FRAME_NS = 16_666_667
SHEAR_MM = st.floats(-30, 30)


def step(
    grip: Grip, frame: int, shear_mm: float, depth_mm: float = 2.0, x_mm: float = 0.0, slip: Slip = Slip.STICK
) -> float:
    return grip.step(frame * FRAME_NS, (shear_mm, 0.0), depth_mm, (x_mm, 0.0), slip)


@given(
    st.lists(
        st.tuples(
            st.integers(0, 2**40), SHEAR_MM, SHEAR_MM, st.floats(0, 20), SHEAR_MM, SHEAR_MM, st.sampled_from(Slip)
        ),
        max_size=30,
    )
)
def test_it_is_within_0_and_1_and_0_while_all_slides(
    frames: list[tuple[int, float, float, float, float, float, Slip]],
) -> None:
    grip = Grip()
    for t_ns, shear_x, shear_y, depth_mm, x, y, slip in frames:
        margin = grip.step(t_ns, (shear_x, shear_y), depth_mm, (x, y), slip)
        assert 0 <= margin <= 1
        assert grip.limit >= LEAST_LIMIT
        if slip is Slip.FULL:
            assert margin == 0


@given(st.lists(st.floats(0, 5), min_size=2, max_size=10), st.floats(0.2, 5), st.floats(0.1, 4))
def test_more_load_is_less_margin(shears_mm: list[float], depth_mm: float, limit: float) -> None:
    margins = [step(Grip(limit), 0, shear_mm, depth_mm) for shear_mm in sorted(shears_mm)]
    assert all(more <= less for less, more in pairwise(margins))
    deeper = [step(Grip(limit), 0, max(shears_mm), depth) for depth in (depth_mm, 2 * depth_mm)]
    assert deeper[0] <= deeper[1]


def test_what_rests_is_firm_and_what_is_loaded_to_the_limit_is_not() -> None:
    assert step(Grip(), 0, 0.0) == 1
    assert step(Grip(), 0, 0.5 * LIMIT * 2.0) == pytest.approx(0.5)
    assert step(Grip(), 0, LIMIT * 2.0) == 0


def test_a_limit_is_learned_from_the_slip() -> None:
    grip = Grip()
    for k in range(30):
        step(grip, k, 0.4, slip=Slip.FULL if k >= 20 else Slip.STICK)
    assert grip.limit == pytest.approx(0.2)
    for k in range(30, 90):
        low, half = step(grip, k, 0.36), grip.limit
    assert (low, half) == (pytest.approx(0.1), pytest.approx(0.2))
    for k in range(90, 150):
        margin = step(grip, k, 0.2)
    assert margin == pytest.approx(0.5)


@pytest.mark.parametrize(("follows", "warns"), [(1.0, False), (0.0, True)])
def test_shear_that_falls_behind_the_motion_counts(follows: float, warns: bool) -> None:
    grip = Grip()
    for k in range(40):
        moved = 0.05 * max(0, k - 20)
        margin = step(grip, k, 0.7 + follows * 0.2 * moved, x_mm=(1 - follows) * moved + follows * 0.2 * moved)
    assert (margin <= ALARM) is warns


def test_noise_is_filtered() -> None:
    rng, grip = np.random.default_rng(1), Grip()
    margins = [step(grip, k, 0.7 + rng.normal(0, 0.1)) for k in range(600)]
    assert np.std(margins[60:]) < 0.6 * 0.1 / (2.0 * LIMIT)
    assert min(margins) > ALARM


def test_another_stream_begins_anew() -> None:
    grip = Grip()
    for k in range(20):
        step(grip, 100 + k, 1.4)
    assert step(grip, 0, 0.0) == 1
    assert math.isclose(grip.limit, LIMIT)
