from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.observed_presses import SEEDS, observed
from tacshade_edge.calibration.observation import (
    DARKENING_FLOOR,
    DARKENING_WEIGHT,
    PressObservation,
    first_touch_mm,
    position_mae_mm,
    screened_change,
    screened_poisson,
)
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.sensor.image.preprocess import GreyMaps
from tacshade_edge.types import F32, Disc, Geometry

SIZES = st.integers(1, 33)
GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))
MIDDLE = PressObservation("", 1, 1, 1, 0, 0, 6.0, 1.0, 0.0, 0.0)


def maps_of(g_d: F32, inside: np.ndarray | None = None) -> GreyMaps:
    g0 = np.full(g_d.shape, 100, np.float32)
    return GreyMaps(g0 + g_d, g0, g_d, np.ones(g_d.shape, bool) if inside is None else inside)


@settings(deadline=None)
@given(SIZES, SIZES, st.floats(0.1, 30), st.integers(0, 2**32 - 1))
def test_psi_solves_its_equation(rows: int, cols: int, reach: float, seed: int) -> None:
    """ψ - ℓ² ∇²ψ = change with mirrored borders, by a dense float64 solve (even sizes:
    no padding).
    """
    rows, cols = 2 * (rows // 8 + 1), 2 * (cols // 8 + 1)
    change = np.random.default_rng(seed).uniform(0, 255, (rows, cols)).astype(np.float32)

    def second_difference(n: int) -> np.ndarray:
        d = np.diag(np.full(n, 2.0)) - np.eye(n, k=1) - np.eye(n, k=-1)
        d[0, 0] = d[-1, -1] = 1.0
        return d if n > 1 else np.zeros((1, 1))

    laplace = np.kron(second_difference(rows), np.eye(cols)) + np.kron(
        np.eye(rows), second_difference(cols)
    )
    psi = np.linalg.solve(np.eye(rows * cols) + reach**2 * laplace, change.ravel().astype(float))
    np.testing.assert_allclose(screened_poisson(change, reach), psi.reshape(rows, cols), atol=0.01)


def test_darkening_counts_as_change_and_the_outside_does_not() -> None:
    change = np.random.default_rng(6).normal(0, 30, (20, 22)).astype(np.float32)
    inside = np.zeros(change.shape, bool)
    inside[4:15, 5:16] = True
    psi = screened_change(maps_of(change, inside), 3.0)
    assert (psi >= 0).all()
    assert not psi[~inside].any()
    # A dark rim says more of the depth than a bright middle:
    # the same change is worth more as darkening.
    dark, bright = (
        screened_change(maps_of(sign * np.abs(change), inside), 3.0) for sign in (-1, 1)
    )
    assert (dark[inside] > bright[inside]).all()


def test_a_constant_brightening_has_the_floor_as_its_darkening() -> None:
    wide = np.full(
        (120, 120), 30, np.float32
    )  # beyond the window nothing changes; the middle is far from there
    chi = screened_change(maps_of(wide), 4.0)[58:62, 58:62]
    np.testing.assert_allclose(
        chi, 30 ** (1 - DARKENING_WEIGHT) * DARKENING_FLOOR**DARKENING_WEIGHT, rtol=1e-3
    )


def test_what_is_not_finite_counts_as_no_change() -> None:
    change = np.full((20, 20), 30, np.float32)
    change[3, 4], change[5, 6] = np.nan, np.inf
    repaired = np.where(np.isfinite(change), change, np.float32(0))
    np.testing.assert_array_equal(
        screened_change(maps_of(change), 4.0), screened_change(maps_of(repaired), 4.0)
    )


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
