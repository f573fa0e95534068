from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.observed_presses import SEEDS, observed

from tacshade_edge.core.calibration.observation.press_observation import PressObservation
from tacshade_edge.core.calibration.presses.travel_fit import agreement_mae_mm, leave_one_out
from tacshade_edge.core.calibration.skin_scale import skin_scale
from tacshade_edge.types import Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))


@pytest.mark.parametrize("seed", SEEDS)
def test_true_depths_agree_and_false_ones_do_not(seed: int) -> None:
    """0.25 mm is what a `good` calibration may have (quality.py); depths 0.6 mm off must not pass for one."""
    presses, geometry = observed(seed)
    scale = skin_scale(geometry)
    assert agreement_mae_mm(presses, geometry) < 0.25 * scale
    off = 0.6 * scale * np.random.default_rng(seed).choice([-1, 1], len(presses))
    false = [replace(o, depth_mm=max(o.depth_mm + float(e), 0.2)) for o, e in zip(presses, off, strict=True)]
    assert agreement_mae_mm(false, geometry) > 0.25 * scale


@pytest.mark.parametrize("seed", SEEDS)
def test_one_false_depth_does_not_move_the_others(seed: int) -> None:
    """Least squares would spread its error; leave-one-out predicts it from the rest alone."""
    presses, geometry = observed(seed)
    before = leave_one_out(presses, geometry)
    k = int(np.argmax([o.depth_mm for o in presses]))
    offset_mm = 3.0 * skin_scale(geometry)
    false = [replace(o, depth_mm=o.depth_mm + offset_mm) if i == k else o for i, o in enumerate(presses)]
    after = leave_one_out(false, geometry)
    others = np.arange(len(presses)) != k
    assert np.abs(after.error_mm - before.error_mm)[others].mean() < 0.1 * skin_scale(geometry)
    assert after.error_mm[k] == pytest.approx(before.error_mm[k] - offset_mm, abs=0.3 * offset_mm)


@settings(max_examples=20)
@given(
    st.lists(
        st.tuples(
            st.floats(1e-3, 200),
            st.floats(0.1, 200),
            st.floats(0.1, 1000),
            st.floats(-20, 20),
            st.floats(-20, 20),
            st.floats(0.01, 1000),
            st.floats(1e-4, 19.9),
        ),
        min_size=1,
        max_size=12,
    )
)
def test_any_presses_have_an_error(numbers: list[tuple[float, ...]]) -> None:
    presses = [PressObservation(str(k), *values, values[3] * 3, -values[4]) for k, values in enumerate(numbers)]
    left_out = leave_one_out(presses, GEOMETRY)
    assert np.isfinite(left_out.error_mm).all()
    assert (left_out.deviations >= 0).all()
    assert math.isfinite(agreement_mae_mm(presses, GEOMETRY))
