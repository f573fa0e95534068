"""A known delay between a picture's change and a scale that is slow, coarse and noisy."""

from __future__ import annotations

import numpy as np
import pytest

from tacshade_edge.capture.labels.clock_offset import ERROR_MOST_S, PRESSES_LEAST, Press, find_offset
from tacshade_edge.types import F64


def pressed(t_s: F64, at_s: float) -> F64:
    """A press of 2 s: down in 0.3 s, held, lifted in 0.2 s."""
    shape: F64 = np.interp(t_s - at_s, (0, 0.3, 1.2, 1.8, 2.0), (0.0, 1.0, 0.8, 0.9, 0.0))
    return shape


def taken(count: int, seed: int, late_s: float, scatter_s: float = 0.0) -> tuple[list[Press], F64, F64]:
    """Pictures at 30/s whose change is no straight line of force; a scale at 10/s, rounded to 10 mN."""
    rng = np.random.default_rng(seed)
    presses = []
    scale_s = np.arange(0, 5.0 * count + 2, 0.1) + rng.uniform(0, 0.01)
    force_n = np.zeros(len(scale_s))
    for k in range(count):
        at_s = 5.0 * k + 1
        t_s = at_s - 0.7 + np.arange(105) / 30
        presses.append(Press(t_s, 4 * pressed(t_s, at_s) ** 0.7 + rng.normal(0, 0.1, len(t_s))))
        force_n += 2 * pressed(scale_s - late_s - scatter_s * (-1) ** k, at_s)
    return presses, scale_s, np.round(force_n + rng.normal(0, 0.01, len(force_n)), 2)


@pytest.mark.parametrize("late_s", [-0.2, 0.0, 0.35, 0.75])
def test_a_delay_is_found_and_its_error_holds(late_s: float) -> None:
    off = []
    for seed in range(8):
        found = find_offset(*taken(6, seed, late_s))
        assert found.presses == 6
        assert found.error_s < 0.02
        off.append((found.offset_s - late_s) / max(found.error_s, 0.004))
    assert np.abs(off).max() < 5
    assert np.abs(np.median(off)) < 3


def test_too_few_presses_and_a_scale_that_sees_other_things_are_refused() -> None:
    presses, t_s, force_n = taken(6, 1, 0.1)
    with pytest.raises(ValueError, match=rf"found 2 presses \(of 2\) .*, expected at least {PRESSES_LEAST}"):
        find_offset(presses[:2], t_s, force_n)
    with pytest.raises(ValueError, match="found 0 presses"):
        find_offset(presses, t_s, np.zeros_like(force_n))
    with pytest.raises(ValueError, match="found 0 presses"):
        find_offset(presses, t_s, np.random.default_rng(2).normal(0, 1, len(t_s)))
    with pytest.raises(ValueError, match="found 0 presses"):
        find_offset(presses, t_s + 2.5, force_n)  # beyond the range
    with pytest.raises(ValueError, match="found 0 presses"):
        find_offset(presses, t_s[:2], force_n[:2])


def test_presses_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ValueError, match=f"expected a standard error of at most {1e3 * ERROR_MOST_S:.0f} ms"):
        find_offset(*taken(4, 3, 0.3, scatter_s=0.25))
