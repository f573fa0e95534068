from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.observed_presses import SEEDS, observed

from tacshade_edge.core.calibration.observation.press_observation import (
    PressObservation,
    first_touch_mm,
    position_mae_mm,
)
from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.types import Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))
MIDDLE = PressObservation("", 1, 1, 1, 0, 0, 6.0, 1.0, 0.0, 0.0)


def test_first_touch() -> None:
    beside = replace(MIDDLE, x_mm=8.0)
    assert first_touch_mm([MIDDLE], GEOMETRY) == pytest.approx(0, abs=1e-9)
    # A ball at (8, 0) touches when the centres are 26 mm apart.
    expected = math.sqrt(400 - 64) - (math.sqrt(26**2 - 64) - 6)
    assert first_touch_mm([beside], GEOMETRY) == pytest.approx(expected)
    assert expected < -0.3


def test_the_place_is_the_stated_one_or_the_located_one() -> None:
    located = replace(MIDDLE, located_x_mm=3.0, located_y_mm=4.0)
    assert located.place_mm == (0.0, 0.0)
    assert position_mae_mm([located, MIDDLE]) == pytest.approx(2.5)
    unstated = replace(located, x_mm=None, y_mm=None)
    assert unstated.place_mm == (3.0, 4.0)
    assert position_mae_mm([unstated]) == 0.0
    assert position_mae_mm([unstated, located]) == pytest.approx(5.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_a_simulated_press_is_located_and_a_deeper_one_changes_more(seed: int) -> None:
    presses, geometry = observed(seed)
    # `_PLACE_LEAST_MM` of press_outliers: above it a single press would be left out.
    assert position_mae_mm(presses) < 3.5 * skin_scale(geometry)
    travel = np.array([o.depth_mm for o in presses]) - first_touch_mm(presses, geometry)
    change = np.array([o.change_grey for o in presses])
    ranks = [np.argsort(np.argsort(values)) for values in (travel, change)]
    assert np.corrcoef(*ranks)[0, 1] > 0.85
