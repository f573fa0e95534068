from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.core import greyscale
from tacshade_edge.core.disc import Grid, disc_mask
from tacshade_edge.types import F32, F64, U8, Binarisation, Disc

RNG = np.random.default_rng(11)


def slow_box(values: U8, window: int, grid: Grid) -> F64:
    """Sum over the part of each window that lies in the image, in float64."""
    half = window // 2
    sums = np.zeros((grid.rows, grid.cols))
    for i in range(grid.rows):
        for j in range(grid.cols):
            row, col = int(grid.row0 + i * grid.step_px), int(grid.col0 + j * grid.step_px)
            cut = values[max(row - half, 0) : row + half + 1, max(col - half, 0) : col + half + 1]
            sums[i, j] = cut.astype(np.float64).sum()
    return sums


@settings(max_examples=40)
@given(
    st.integers(1, 40), st.integers(1, 40), st.integers(0, 30), st.integers(1, 5), st.sampled_from([1, 255]),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_box_sums_are_exact(height: int, width: int, half: int, step: int, top: int, seed: int) -> None:
    values = np.random.default_rng(seed).integers(0, top + 1, (height, width), dtype=np.uint8)
    grid = Grid.of_image(height, width, step)
    sums = greyscale.box_sums(values, 2 * half + 1, grid)
    assert sums.dtype == np.float32
    np.testing.assert_array_equal(sums, slow_box(values, 2 * half + 1, grid))


def test_a_window_over_255_px_is_exact_too() -> None:
    ones = np.ones((300, 310), np.uint8)
    grid = Grid.of_image(300, 310, 50)
    for window in (255, 257, 299):
        np.testing.assert_array_equal(greyscale.box_sums(ones, window, grid), slow_box(ones, window, grid))


@settings(max_examples=40)
@given(
    st.integers(3, 40), st.integers(3, 40), st.integers(0, 9), st.integers(1, 4),
    st.floats(-10, 50), st.floats(-10, 50), st.floats(0, 30), st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_eq_1_counts_only_the_disc(
    height: int, width: int, half: int, step: int, row_c: float, col_c: float, radius: float, seed: int
) -> None:
    mask = disc_mask(height, width, Disc(row_c, col_c, radius)).astype(np.uint8)
    white = mask * np.random.default_rng(seed).integers(0, 2, mask.shape, dtype=np.uint8)
    grid, window = Grid.of_image(height, width, step), 2 * half + 1
    total = greyscale.box_sums(mask, window, grid)
    g = greyscale.white_ratio(white, total, window, grid)
    s_w, s_t = slow_box(white, window, grid), slow_box(mask, window, grid)
    np.testing.assert_allclose(g, np.where(s_t > 0, 255 * s_w / np.maximum(s_t, 1), 0), rtol=1e-6, atol=1e-6)
    assert (g >= 0).all()
    assert (g <= 255).all()
    stored = greyscale.white_ratio(255 * white, total, window, grid, full_scale=1.0)
    np.testing.assert_allclose(stored, g, rtol=1e-6)


def test_an_odd_window_is_the_nearest() -> None:
    assert [greyscale.odd(v) for v in (-3, 0, 0.4, 1, 1.9, 2.1, 3, 18.9, 37.92)] == [1, 1, 1, 1, 1, 3, 3, 19, 37]


@pytest.mark.parametrize("method", ["adaptive", "global", "otsu"])
def test_markers_are_white_and_the_outside_is_not(method: Binarisation) -> None:
    grey = np.full((60, 60), 20, np.uint8)
    for row in range(5, 60, 10):
        for col in range(5, 60, 10):
            cv2.circle(grey, (col, row), 2, 200, -1)
    mask = disc_mask(60, 60, Disc(30, 30, 25)).astype(np.uint8)
    bright = np.where(mask > 0, grey, 255).astype(np.uint8)
    np.testing.assert_array_equal(greyscale.binarise(bright, mask, method, 10.0), (grey > 100) * mask)


@pytest.mark.parametrize("method", ["adaptive", "global", "otsu"])
@pytest.mark.parametrize("level", [0, 128, 255])
def test_a_constant_has_one_colour(method: Binarisation, level: int) -> None:
    mask = disc_mask(40, 40, Disc(20, 20, 15)).astype(np.uint8)
    white = greyscale.binarise(np.full((40, 40), level, np.uint8), mask, method, 8.0)
    assert not white[mask == 0].any()
    assert len(np.unique(white[mask > 0])) == 1
    assert not greyscale.binarise(np.full((40, 40), level, np.uint8), 0 * mask, method, 8.0).any()


def test_adaptive_survives_light_that_global_does_not() -> None:
    flat = np.full((120, 120), 0.2)
    for row in range(5, 120, 10):
        for col in range(5, 120, 10):
            cv2.circle(flat, (col, row), 3, 1.0, -1)
    lit = (flat * np.linspace(45, 250, 120)[None, :]).astype(np.uint8)
    mask = np.ones((120, 120), np.uint8)
    wrong = {m: np.mean(greyscale.binarise(lit, mask, m, 10.0) != (flat > 0.5)) for m in ("adaptive", "global")}
    assert wrong["adaptive"] < 0.002
    assert wrong["global"] > 0.015


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


def test_normalise_spans_zero_to_one_over_the_disc_alone() -> None:
    values = np.array([[-9, 1, 2, 3, 99]], np.float32)
    inside = np.array([[False, True, True, True, False]])
    np.testing.assert_array_equal(greyscale.normalise(values, inside), [[0, 0, 0.5, 1, 0]])
