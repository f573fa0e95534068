from __future__ import annotations

import numpy as np
import pytest

from tacshade_edge.core.contact.gate import GATE_NOISE, gate
from tacshade_edge.types import F32

LEVELS = 15.0


def patch(level: float, cells: int = 9, base: float = 0.0) -> F32:
    g_d = np.full(600, base, np.float32)
    g_d[150 : 150 + cells] += level
    return g_d


def test_the_gate_opens_on_enough_change_over_enough_skin() -> None:
    assert gate(patch(LEVELS + 1, 3), 0.0, 0.5, 1.0, LEVELS)
    assert not gate(patch(LEVELS + 1, 2), 0.0, 0.5, 1.0, LEVELS)  # 2 mm²
    assert not gate(patch(LEVELS - 1), 0.0, 0.5, 1.0, LEVELS)
    assert not gate(patch(-100), 0.0, 0.5, 1.0, LEVELS)


def test_a_rim_that_darkens_opens_it_where_that_counts() -> None:
    assert gate(patch(-11, 3), 0.0, 0.5, 1.0, LEVELS, 10.0)
    assert not gate(patch(-9, 9), 0.0, 0.5, 1.0, LEVELS, 10.0)
    assert not gate(patch(-11, 2), 0.0, 0.5, 1.0, LEVELS, 10.0)  # 2 mm²
    assert not gate(patch(-11, 9), 0.0, 3.0, 1.0, LEVELS, 10.0)  # within the noise
    assert not gate(patch(-200, 9), 0.0, 0.5, 1.0, LEVELS)


def test_a_noisy_sensor_has_a_higher_gate() -> None:
    level = GATE_NOISE * 10
    assert not gate(patch(level - 1), 0.0, 10.0, 1.0, LEVELS)
    assert gate(patch(level + 1), 0.0, 10.0, 1.0, LEVELS)


@pytest.mark.parametrize("base", [-25.0, 25.0])
def test_a_change_of_light_is_taken_off(base: float) -> None:
    assert not gate(patch(0, base=base), base, 0.5, 1.0, LEVELS)
    assert gate(patch(LEVELS + 1, base=base), base, 0.5, 1.0, LEVELS)


def test_nobody_votes_for_nothing() -> None:
    assert not gate(np.empty(0, np.float32), 0.0, 0.5, 1.0, LEVELS)
