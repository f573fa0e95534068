import numpy as np
import pytest
from support.calibrated_sensor import HALF, simulated

from tacshade_edge.simulator.objects import bars, ridge
from tacshade_edge.simulator.press import Press
from tacshade_edge.types import HeightMap
from tools.studies.limits.across import across, dip_mm, found_heights, top_mm


@pytest.mark.parametrize("turn", [0.0, 60.0])
def test_the_true_profile_shows_the_bars_and_the_gap(turn: float) -> None:
    press = Press(bars(2.0, 5.0), 0.5, -0.5, 2.0, turn)
    line = across(simulated(HALF).frame((press,), 1), press)
    assert np.all(np.diff(line.x_mm) > 0)
    bar, middle = line.true_mm[np.abs(np.abs(line.x_mm) - 3.5) < 0.8], line.true_mm[np.abs(line.x_mm) < 0.3]
    assert bar.min() > 1.2 > middle.max()
    dip = dip_mm(line.x_mm, line.true_mm, 2.0, 5.0)
    assert 0.5 < dip < 1.6


def test_a_ridge_reaches_its_depth_at_its_middle() -> None:
    press = Press(ridge(1.0), 0.0, 0.0, 2.0)
    line = across(simulated(HALF).frame((press,), 1), press)
    assert top_mm(line.x_mm, line.true_mm, 1.0) == pytest.approx(2.0, abs=0.05)


def test_a_map_is_sampled_where_the_line_lies() -> None:
    press = Press(ridge(1.0), 0.0, 0.0, 2.0)
    line = across(simulated(HALF).frame((press,), 1), press)
    rows, cols = np.mgrid[:60, :80]
    columns = np.asarray(2 + 4.0 * cols, np.float32)  # each cell tells its pixel's column
    found = found_heights(line, HeightMap(columns, np.zeros(rows.shape, bool), 2.0, 2.0, 4.0))
    np.testing.assert_allclose(found, line.col, atol=0.1)


def test_dip_is_under_the_lower_bar() -> None:
    x = np.linspace(-4, 4, 801)
    h = np.where(x < 0, 2.0, 1.5) - np.where(np.abs(x) < 1, 1.2, 0)
    assert dip_mm(x, h, 2.0, 2.0) == pytest.approx(1.5 - 0.3)
