"""Where a touch begins, from frames in which nothing touches."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.sensor.contact.gate import SURE_PART
from tacshade_edge.sensor.contact.rest import (
    KINDS,
    LEAST_FRAMES,
    WAYS,
    Evidence,
    limits_of,
    moved_by_a_pixel,
    upper_bound,
)


@pytest.mark.parametrize(("count", "rate"), [(8, 0.02), (20, 0.005), (200, 0.002)])
def test_an_exponential_tail_is_exceeded_at_the_stated_rate(count: int, rate: float) -> None:
    rng = np.random.default_rng(1)
    trials = 4000
    rest = rng.exponential(size=(trials, count))
    # The chance that the next value exceeds a bound is known, so that no draw of it adds noise.
    chances = [np.exp(-max(upper_bound(some, rate), 0.0)) for some in rest]
    assert np.mean(chances) == pytest.approx(rate, rel=0.15)


@pytest.mark.parametrize("count", [17, 60, 300])
def test_greatest_values_of_a_noisy_map_exceed_it_more_rarely(count: int) -> None:
    rng = np.random.default_rng(2)
    rate = 1e-3
    exceeded = []
    for _ in range(40):
        maps = rng.normal(size=(count + 2000, 100)).max(axis=1)
        exceeded.append(np.mean(maps[count:] > upper_bound(maps[:count], rate)))
    assert np.mean(exceeded) <= rate


def test_enough_frames_need_no_assumption() -> None:
    values = np.random.default_rng(3).permutation(999)
    assert upper_bound(values, 0.001) == 998
    assert upper_bound(values, 0.01) == 989
    assert upper_bound(values, 0.1) == 899


@given(
    st.lists(st.floats(-50, 50), min_size=2, max_size=60),
    st.floats(1e-8, 0.1),
)
def test_a_bound_is_finite_and_falls_with_the_rate(values: list[float], rate: float) -> None:
    bound = upper_bound(values, rate)
    assert np.isfinite(bound)
    assert bound >= upper_bound(values, min(10 * rate, 0.5)) - 1e-9


def test_few_frames_give_no_limits() -> None:
    some = [Evidence(0.01 + 0.001 * k, 0.001 * k, 0.01) for k in range(LEAST_FRAMES)]
    assert limits_of(some[1:], [], 1e-4) is None
    limits = limits_of(some, [], 1e-4)
    assert limits is not None
    assert (limits.frames, limits.false_contacts) == (LEAST_FRAMES, 1e-4)


def test_each_kind_of_evidence_has_a_part_of_the_rate() -> None:
    rng = np.random.default_rng(4)
    some = [
        Evidence(0.01 * rng.random(), 0.004 * rng.random(), 0.02 * rng.random()) for _ in range(100)
    ]
    limits = limits_of(some, [], 1e-3)
    assert limits is not None
    assert limits.height_mm == upper_bound([one.height_mm for one in some], 1e-3 / KINDS)
    assert limits.local_change == upper_bound([one.local_change for one in some], 1e-3 / KINDS)
    assert limits.changed_part == SURE_PART


def test_heights_that_do_not_vary_must_double() -> None:
    limits = limits_of([Evidence(0.006, 0.001 * k, 0.01) for k in range(20)], [], 1e-4)
    assert limits is not None
    assert limits.height_mm == 0.012


def test_limits_allow_for_what_a_pixel_of_drift_adds() -> None:
    rng = np.random.default_rng(6)
    some = [Evidence(0.02 * rng.random(), 0.004 * rng.random(), 0.0) for _ in range(60)]
    moved = [[Evidence(0.05, -0.1, 0.0)] * 3, [Evidence(0.03, 0.009, 0.0)] * 2, []]
    bare, limits = limits_of(some, [], 1e-4), limits_of(some, moved, 1e-4)
    assert bare is not None
    assert limits is not None
    usual_mm = np.median([one.height_mm for one in some])
    usual = np.median([one.local_change for one in some])
    assert limits.height_mm == pytest.approx(bare.height_mm + 0.05 - usual_mm)
    assert limits.local_change == pytest.approx(bare.local_change + 0.009 - usual)


@pytest.mark.parametrize("shape", [(5, 4), (5, 4, 3)])
def test_a_picture_moves_in_four_ways(shape: tuple[int, ...]) -> None:
    image = np.random.default_rng(7).integers(0, 256, shape, np.uint8)
    down, up, right, left = (moved_by_a_pixel(image, way) for way in range(WAYS))
    np.testing.assert_array_equal(down[1:], image[:-1])
    np.testing.assert_array_equal(up[:-1], image[1:])
    np.testing.assert_array_equal(right[:, 1:], image[:, :-1])
    np.testing.assert_array_equal(left[:, :-1], image[:, 1:])
    for moved, edge in ((down, 0), (up, -1)):
        np.testing.assert_array_equal(moved[edge], image[edge])
    np.testing.assert_array_equal(right[:, 0], image[:, 0])
