"""Lost frames inferred from time stamps alone."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.camera.frame_source import FrameGaps

pytestmark = pytest.mark.slow

PERIOD_NS = 40_000_000


def counted(numbers: list[int], jitter_ns: np.ndarray | None = None) -> int:
    """Feed the stamps of the frames with these numbers; return what was inferred."""
    gaps = FrameGaps()
    jitter = np.zeros(len(numbers), int) if jitter_ns is None else jitter_ns
    return sum(
        gaps.add(7 + number * PERIOD_NS + int(j)) for number, j in zip(numbers, jitter, strict=True)
    )


def test_losses_before_the_period_is_known_are_counted_when_it_is() -> None:
    gaps = FrameGaps()
    found = [gaps.add(number * PERIOD_NS) for number in (0, *range(3, 27), 28)]
    assert found == [*[0] * 24, 2, 1]


def test_a_camera_that_slows_down_a_little_at_a_time_loses_nothing() -> None:
    gaps, t_ns = FrameGaps(), 0
    for number in range(1000):
        t_ns += PERIOD_NS + number * PERIOD_NS // 1000
        assert gaps.add(t_ns) == 0
    assert 1.9 * PERIOD_NS < gaps.period_ns < 2 * PERIOD_NS


def test_a_camera_that_halves_its_rate_loses_frames_until_the_window_has_turned_over() -> None:
    gaps = FrameGaps()
    assert sum(gaps.add(number * PERIOD_NS) for number in range(100)) == 0
    found = [gaps.add((99 + 2 * number) * PERIOD_NS) for number in range(1, 150)]
    assert found[0] == 1
    assert not any(found[64:])
    assert gaps.period_ns == 2 * PERIOD_NS


def test_a_long_stall_is_counted_in_full() -> None:
    numbers = [*range(50), *range(100, 120)]
    assert counted(numbers) == 50


@given(st.lists(st.booleans(), min_size=300, max_size=300), st.integers(0, 2**32 - 1))
def test_random_losses_with_jitter(lots: list[bool], seed: int) -> None:
    """Every third frame may be lost, each stamp is off by up to a tenth of the period."""
    rng = np.random.default_rng(seed)
    numbers = [number for number, kept in enumerate(lots) if kept or number % 3]
    jitter = rng.uniform(-0.1, 0.1, len(numbers)) * PERIOD_NS
    truth = numbers[-1] - numbers[0] + 1 - len(numbers)
    assert abs(counted(numbers, jitter) - truth) <= 1


@given(st.lists(st.integers(-(2**62), 2**62), max_size=40))
def test_any_stamps_give_a_count(stamps: list[int]) -> None:
    gaps = FrameGaps()
    assert all(gaps.add(stamp) >= 0 for stamp in stamps)
    advances = sum(later > earlier for earlier, later in itertools.pairwise(stamps))
    assert (gaps.period_ns > 0) == (advances > 0)
