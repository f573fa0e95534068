from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.contact.margin import ALARM, LEAST_LIMIT, LIMIT, SLIDE_NS, Grip
from tacshade_edge.types import Slip

FRAME_NS = 16_666_667
SHEAR_MM = st.floats(-30, 30)
FRAME = st.tuples(st.integers(0, 2**40), SHEAR_MM, SHEAR_MM, st.floats(0, 20), st.sampled_from(Slip))


def step(grip: Grip, frame: int, shear_mm: float, depth_mm: float = 2.0, slip: Slip = Slip.STICK) -> float:
    return grip.step(frame * FRAME_NS, (shear_mm, 0.0), depth_mm, slip)


@given(st.lists(FRAME, max_size=30))
def test_it_is_within_0_and_1(frames: list[tuple[int, float, float, float, Slip]]) -> None:
    grip = Grip()
    for t_ns, x_mm, y_mm, depth_mm, slip in frames:
        assert 0 <= grip.step(t_ns, (x_mm, y_mm), depth_mm, slip) <= 1
        assert grip.limit >= LEAST_LIMIT


@given(st.lists(SHEAR_MM, min_size=6, max_size=30), st.floats(0, 20))
def test_it_is_0_while_the_whole_contact_slides(shears_mm: list[float], depth_mm: float) -> None:
    grip = Grip()
    margins = [step(grip, k, shear_mm, depth_mm, Slip.FULL) for k, shear_mm in enumerate(shears_mm)]
    assert set(margins[-(-SLIDE_NS // FRAME_NS) :]) == {0.0}


@given(st.lists(st.floats(0, 5), min_size=2, max_size=10), st.floats(0.2, 5), st.floats(0.1, 4))
def test_more_load_along_is_less_margin_and_more_across_is_more(
    shears_mm: list[float], depth_mm: float, limit: float
) -> None:
    margins = [step(Grip(limit), 0, shear_mm, depth_mm) for shear_mm in sorted(shears_mm)]
    assert all(more <= less for less, more in pairwise(margins))
    assert margins[-1] <= step(Grip(limit), 0, max(shears_mm), 2 * depth_mm)


def test_what_only_presses_is_firm_and_what_is_loaded_to_the_limit_is_not() -> None:
    assert step(Grip(), 0, 0.0) == 1
    assert step(Grip(), 0, 0.5 * LIMIT * 2.0) == pytest.approx(0.5)
    assert step(Grip(), 0, LIMIT * 2.0) == 0


def test_the_limit_is_learned_from_a_slide() -> None:
    grip = Grip()
    for k in range(60):
        step(grip, k, 0.4, slip=Slip.FULL if 20 <= k < 30 else Slip.STICK)
    assert grip.limit == pytest.approx(0.2)
    for k in range(60, 120):
        margin = step(grip, k, 0.2)
    assert margin == pytest.approx(0.5, abs=1e-3)


def test_a_slide_of_two_frames_is_none() -> None:
    grip = Grip()
    margins = [step(grip, k, 0.4, slip=Slip.FULL if k in (20, 21) else Slip.STICK) for k in range(40)]
    assert (min(margins), grip.limit) == (pytest.approx(1 - 0.2 / LIMIT), LIMIT)


def test_noise_is_filtered() -> None:
    rng, grip = np.random.default_rng(1), Grip()
    margins = [step(grip, k, 0.7 + rng.normal(0, 0.1)) for k in range(600)]
    assert np.std(margins[60:]) < 0.5 * 0.1 / (2.0 * LIMIT)
    assert min(margins) > ALARM


def test_another_stream_begins_anew() -> None:
    grip = Grip()
    for k in range(20):
        step(grip, 100 + k, 1.4)
    assert step(grip, 0, 0.0) == 1


def test_a_load_that_went_back_was_borne() -> None:
    grip = Grip()
    margins = [step(grip, k, 1.0 + 0.3 * np.sin(k / 5)) for k in range(240)]
    assert grip.limit == pytest.approx(1.5 * 0.62, abs=0.01)
    assert margins[8] < ALARM < min(margins[40:])


def test_a_load_that_grows_is_not_borne_yet() -> None:
    grip = Grip()
    assert min(step(grip, k, 0.02 * k) for k in range(60)) < ALARM
    assert grip.limit == LIMIT


@pytest.mark.parametrize(("slid", "limit"), [(False, 0.9), (True, 0.6)])
def test_what_was_borne_shows_that_the_limit_is_higher(slid: bool, limit: float) -> None:
    grip = Grip()
    for k in range(10):
        step(grip, k, 0.4, slip=Slip.FULL if slid else Slip.STICK)
    for k in range(10, 120):
        step(grip, k, 1.2)
    assert grip.limit == pytest.approx(0.2 if slid else LIMIT)
    for k in range(120, 300):
        step(grip, k, 1.2)
    assert grip.limit == pytest.approx(limit, abs=1e-3)
