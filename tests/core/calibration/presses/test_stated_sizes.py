from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.calibration.presses.stated_sizes import ShownSizes, size_mistake, theil_sen_slope
from tacshade_edge.types import Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))


@given(st.integers(0, 2**32 - 1), st.integers(5, 40))
def test_the_slope_is_scipys(seed: int, count: int) -> None:
    from scipy.stats import theilslopes  # takes a second, which whoever only collects this need not spend

    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 5, count)
    y = 0.3 + 1.1 * x + 0.2 * rng.standard_normal(count)
    assert theil_sen_slope(x, y) == pytest.approx(theilslopes(y, x).slope)


@pytest.mark.parametrize(
    ("shown", "said"),
    [
        (ShownSizes(1.1, 0.53, 0.54), "are they diameters?"),
        (ShownSizes(0.82, 0.53, 0.54), "are they diameters?"),  # with a network that finds depths too small
        (ShownSizes(0.82, 0.79, 0.86), ""),  # depths 0.7 and 1 mm too great, of tools/studies/calibration.py's 8401
        (ShownSizes(0.73, 0.71, 0.84), ""),
        (ShownSizes(1.0, 0.79, 0.96), ""),  # a good table of a skin of 12 mm
        (ShownSizes(1.05, 0.79, 0.79), ""),  # a good table of a stiff skin on a soft gel (the third family)
        (ShownSizes(1.0, 2.1, 2.1), "are they halved?"),
        (ShownSizes(1.0, math.nan, math.nan), ""),
    ],
)
def test_balls_that_look_smaller_are_diameters_where_depths_do_not(shown: ShownSizes, said: str) -> None:
    assert size_mistake(shown, (), GEOMETRY).count("\n") == 0
    assert (said in size_mistake(shown, (), GEOMETRY)) if said else not size_mistake(shown, (), GEOMETRY)
