from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.core.image import greyscale
from tacshade_edge.types import F32, F64, Disc

RNG = np.random.default_rng(11)


@given(st.integers(0, 2**32 - 1), st.integers(1, 2000))
def test_eq_1_counts_only_the_disc(seed: int, most: int) -> None:
    rng = np.random.default_rng(seed)
    s_t = rng.integers(0, most + 1, (5, 7)).astype(np.float32)
    s_w = np.rint(s_t * rng.random(s_t.shape)).astype(np.float32)
    g = greyscale.white_ratio(s_w, s_t)
    exact = np.where(s_t > 0, 255 * s_w.astype(float) / np.maximum(s_t, 1).astype(float), 0)
    np.testing.assert_allclose(g, exact, rtol=1e-6, atol=1e-6)
    assert (g >= 0).all()
    assert (g <= 255).all()
    np.testing.assert_allclose(greyscale.white_ratio(255 * s_w, s_t, full_scale=1.0), g, rtol=1e-6)


def test_grey_of_three_equal_channels_is_that_channel() -> None:
    grey = RNG.integers(0, 256, (16, 256), dtype=np.uint8)
    np.testing.assert_array_equal(greyscale.to_grey(np.dstack([grey] * 3)), grey)
    assert greyscale.to_grey(grey) is grey


def test_tv_does_not_see_the_outside() -> None:
    g = RNG.uniform(0, 255, (30, 30)).astype(np.float32)
    inside = disc_mask(30, 30, Disc(15, 15, 10))
    other = np.where(inside, g, np.float32(255))
    smooth, again = (greyscale.denoise_tv(v, inside, 0.1) for v in (g, other))
    np.testing.assert_array_equal(smooth[inside], again[inside])


@pytest.mark.parametrize("level", [0, 100, 255])
def test_tv_keeps_a_constant_and_leaves_an_empty_disc_alone(level: float) -> None:
    g = np.full((20, 20), level, np.float32)
    np.testing.assert_allclose(greyscale.denoise_tv(g, np.ones(g.shape, bool), 0.1), g, atol=1e-3)
    assert greyscale.denoise_tv(g, np.zeros(g.shape, bool), 0.1) is g
    assert greyscale.denoise_tv(g, np.ones(g.shape, bool), 0) is g


def literal_eq_10(g_d: F32, g0: F32, inside: np.ndarray) -> F64:
    """Eq. 10 and the normalisation after it, cell by cell in float64."""

    def norm(values: dict[tuple[int, int], float]) -> dict[tuple[int, int], float]:
        low, high = min(values.values()), max(values.values())
        return {k: (v - low) / (high - low) if high > low else 0.0 for k, v in values.items()}

    cells = [tuple(c) for c in np.argwhere(inside)]
    g_hn = norm({c: v * float(g0[c]) for c, v in norm({c: float(g_d[c]) for c in cells}).items()})
    result = np.zeros(g_d.shape)
    for cell, value in g_hn.items():
        result[cell] = value
    return result


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_eqs_9_and_10_are_the_literal_ones(sign: float) -> None:
    g, g0 = (RNG.uniform(0, 255, (12, 14)).astype(np.float32) for _ in range(2))
    inside = disc_mask(12, 14, Disc(6, 7, 5))
    g_d = greyscale.grey_difference(g, g0, inside, sign)
    np.testing.assert_allclose(g_d[inside], sign * (g[inside].astype(float) - g0[inside]), atol=1e-4)
    assert not g_d[~inside].any()
    np.testing.assert_allclose(greyscale.shape_grey(g_d, g0, inside), literal_eq_10(g_d, g0, inside), atol=1e-5)


@pytest.mark.parametrize("level", [0.0, 7.5, -3.0])
def test_constants_normalise_to_zero(level: float) -> None:
    values, inside = np.full((5, 6), level, np.float32), np.ones((5, 6), bool)
    assert not greyscale.normalise(values, inside).any()
    assert not greyscale.normalise(values, ~inside).any()
    assert not greyscale.shape_grey(values, values, inside).any()


def test_what_lies_outside_the_disc_is_not_divided() -> None:
    values = np.array([[0.0, np.finfo(np.float32).tiny, 4.0]], np.float32)
    np.testing.assert_array_equal(greyscale.normalise(values, np.array([[True, True, False]])), [[0, 1, 0]])


def test_normalise_spans_zero_to_one_over_the_disc_alone() -> None:
    values = np.array([[-9, 1, 2, 3, 99]], np.float32)
    inside = np.array([[False, True, True, True, False]])
    np.testing.assert_array_equal(greyscale.normalise(values, inside), [[0, 0, 0.5, 1, 0]])
