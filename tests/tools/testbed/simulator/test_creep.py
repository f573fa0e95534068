import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import skin_under
from tacshade_edge.types import F32
from tools.testbed.simulator.creep import imprint, kept, rest

PART, TAU_S = 0.1, 0.8


def remembered(times_s: list[float], loads: list[float], t_s: float) -> float:
    return float(kept(times_s, t_s, PART, TAU_S) @ np.array(loads))


@pytest.mark.parametrize("t_s", [0.0, 0.1, 0.8, 3.0])
def test_a_held_load_creeps_and_its_dent_recovers_exponentially(t_s: float) -> None:
    # The two closed forms of a Zener body: creep under a step of load, recovery after it.
    held_s = 5.0
    creep = remembered([0.0, held_s], [2.0, 2.0], t_s)
    assert creep == pytest.approx(2.0 * PART * (1 - math.exp(-t_s / TAU_S)), abs=1e-12)
    left = remembered([0.0, held_s], [2.0, 2.0], held_s + t_s)
    at_release = 2.0 * PART * (1 - math.exp(-held_s / TAU_S))
    assert left == pytest.approx(at_release * math.exp(-t_s / TAU_S), abs=1e-12)
    assert left <= 0.1 * (2.0 + at_release)


@pytest.mark.parametrize("t_s", [0.3, 1.0, 1.5, 4.0])
def test_a_ramp_is_integrated_exactly(t_s: float) -> None:
    # u = s up to 1 s, gone then: τ e' = c u - e has the solution c (s - τ + τ exp(-s / τ)).
    end = min(t_s, 1.0)
    expected = PART * (end - TAU_S + TAU_S * math.exp(-end / TAU_S)) * math.exp(-(t_s - end) / TAU_S)
    assert remembered([0.0, 1.0], [0.0, 1.0], t_s) == pytest.approx(expected, abs=1e-12)


@given(
    gaps=st.lists(st.floats(1e-6, 100.0), min_size=1, max_size=8),
    t_s=st.floats(-10, 1000),
    part=st.floats(0, 1 / 9),
    creep_s=st.floats(0.1, 3.0),
)
def test_no_history_leaves_more_than_its_part_and_knots_between_change_nothing(
    gaps: list[float], t_s: float, part: float, creep_s: float
) -> None:
    times = np.cumsum([0.0, *gaps])
    weights = kept(times, t_s, part, creep_s)
    assert weights.min() >= 0
    assert weights.sum() <= part + 1e-9
    loads = np.interp(times, times[[0, -1]], [1.0, 3.0])
    alone = kept(times[[0, -1]], t_s, part, creep_s) @ loads[[0, -1]]
    assert weights @ loads == pytest.approx(alone, abs=1e-8)
    if t_s <= 0:
        assert not weights.any()


def middle(grid: F32) -> float:
    return float(grid[len(grid) // 2, len(grid) // 2])


def test_an_object_on_a_crept_skin_touches_it_where_it_reaches_beyond() -> None:
    model = SensorModel()
    load = imprint(skin_under(model, (Press(ball(5.0), depth_mm=3.0),)))
    left = rest([load], [0.1], model.skin_radius_mm, None)
    assert middle(left.height_mm) == pytest.approx(0.3, abs=1e-3)
    shallow = skin_under(model, (Press(ball(5.0), depth_mm=0.2),), left)
    assert np.array_equal(shallow.height_mm, left.height_mm)
    deep = skin_under(model, (Press(ball(5.0), depth_mm=3.3),), left)
    assert middle(deep.height_mm) == pytest.approx(3.3, abs=2e-3)
    assert deep.rest_mm is not None
    assert np.min(deep.height_mm - deep.rest_mm) >= 0
    assert np.min(deep.height_mm - deep.obstacle_mm) >= -1e-6


@pytest.mark.slow
def test_a_dent_is_where_the_material_is() -> None:
    model = SensorModel(coulomb=50.0, sway=0.0)
    skin = skin_under(model, (Press(ball(5.0), 2.0, 0.0, 3.0, drag_x_mm=2.0),))
    load = imprint(skin)
    home = rest([load], [0.1], model.skin_radius_mm, None)
    along = rest([load], [0.1], model.skin_radius_mm, skin.origin_mm)
    steps = 2.0 / skin.step_mm
    row = len(home.height_mm) // 2
    assert np.argmax(home.height_mm[row]) - row == pytest.approx(0, abs=2)
    assert np.argmax(along.height_mm[row]) - row == pytest.approx(steps, abs=2)
    assert np.abs(along.height_mm - 0.1 * skin.height_mm).max() < 0.02
    assert home.origin_mm is not None
    assert skin.origin_mm is not None
    assert home.origin_mm == pytest.approx(0.1 * skin.origin_mm, abs=1e-6)
