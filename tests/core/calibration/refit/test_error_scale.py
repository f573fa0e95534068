from __future__ import annotations

import numpy as np
import pytest
from support.calibrated_sensor import HALF, calibrated

from tacshade_edge.core.calibration.refit.error_scale import error_scale, errors_in_sigma, press_q
from tacshade_edge.core.depth.sigma import INTERVAL_90, SigmaModel

FLAT = SigmaModel((0.0,) * 5, 3.0, 0.0, 1.0)
"""1 mm everywhere on a skin of 20 mm, and q is the scale."""


def test_presses_count_alike_however_large() -> None:
    large, small = np.full(1000, 1.0), np.full(10, 5.0)
    assert press_q([large] * 9 + [small]) == pytest.approx(1 / INTERVAL_90)
    assert press_q([large] * 8 + [small] * 2) == pytest.approx(5 / INTERVAL_90)
    assert press_q([np.zeros(4)]) > 0


def test_the_scale_follows_from_q_by_the_line_and_stays_in_its_range() -> None:
    errors = [np.full(10, 2 * INTERVAL_90)]
    assert error_scale(FLAT, errors) == pytest.approx(2.0)
    line = SigmaModel(FLAT.weights, 3.0, np.log(1.5), 0.5)
    assert error_scale(line, errors) == pytest.approx(1.5 * np.sqrt(2))
    assert error_scale(FLAT, [np.full(10, 1e9)]) == 20.0
    assert error_scale(FLAT, [np.zeros(10)]) == 0.2


def test_errors_are_those_of_the_known_cells() -> None:
    geometry = calibrated().geometry
    height = np.full((112, 112), 2.0, np.float32)
    true, known = height.copy(), np.zeros((112, 112), bool)
    known[50:52, 50] = True
    true[50, 50], true[51, 50] = 1.5, 3.0
    size_mm = HALF.skin_radius_mm / 20
    logits = np.zeros((112, 112), np.float32), np.full((28, 28), -9, np.float32)
    found = errors_in_sigma(FLAT, height, true, *logits, known, geometry)
    np.testing.assert_allclose(found, np.array([0.5, 1.0]) / size_mm, rtol=1e-6)
