from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.core.geometry.disc import Grid, Window
from tacshade_edge.core.image import integral_image
from tacshade_edge.core.image.integral_image import Sums
from tacshade_edge.types import F64, U8


def slow_box(values: U8, window: int, grid: Grid) -> F64:
    """Sum over the part of each box that lies in the window, which begins at row 3 and column 5, in float64."""
    half = window // 2
    sums = np.zeros((grid.rows, grid.cols))
    for i in range(grid.rows):
        for j in range(grid.cols):
            row, col = int(grid.row0 + i * grid.step_px) - 3, int(grid.col0 + j * grid.step_px) - 5
            cut = values[max(row - half, 0) : row + half + 1, max(col - half, 0) : col + half + 1]
            sums[i, j] = cut.astype(np.float64).sum()
    return sums


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 40), st.integers(1, 40), st.integers(0, 30), st.integers(1, 5), st.sampled_from([1, 255]),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_box_sums_are_exact(height: int, width: int, half: int, step: int, top: int, seed: int) -> None:
    values = np.random.default_rng(seed).integers(0, top + 1, (height, width), dtype=np.uint8)
    window = Window(3, 5, height, width)
    grid, shown = Grid.of_window(window, step), Sums(window, half + 1)
    shown.show(255 - values)  # what was shown before does not matter
    shown.show(values)
    found = shown.boxes(grid, 2 * half + 1)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, slow_box(values, 2 * half + 1, grid))


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 30), st.integers(1, 30), st.floats(-20, 40), st.floats(-20, 40), st.floats(0.3, 9),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_means_are_those_of_square_pixels(
    height: int, width: int, row0: float, col0: float, step: float, seed: int
) -> None:
    values = np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)
    grid, shown = Grid(4, 6, row0, col0, step), Sums(Window(3, 5, height, width), 2)
    shown.show(values)

    def overlap(first: float, count: int, start: int, size: int) -> F64:
        """How much of each pixel (columns) each cell (rows) covers."""
        low = first + step * (np.arange(count)[:, None] - 0.5)
        pixel = start + np.arange(size)[None, :]
        return np.clip(np.minimum(low + step, pixel + 0.5) - np.maximum(low, pixel - 0.5), 0, None)

    exact = overlap(row0, 4, 3, height) @ values.astype(float) @ overlap(col0, 6, 5, width).T / step**2
    np.testing.assert_allclose(shown.means(shown.cells_of(grid)), exact, atol=255e-4 / min(step, 1) ** 2)


def test_an_integral_beyond_int32_is_exact_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(integral_image, "_EXACT", 1000)
    values = np.random.default_rng(2).integers(0, 256, (20, 24), dtype=np.uint8)
    grid, shown = Grid.of_window(Window(3, 5, 20, 24), 3), Sums(Window(3, 5, 20, 24), 5)
    for each in (values, values // 255, values):
        shown.show(each)
        np.testing.assert_array_equal(shown.boxes(grid, 7), slow_box(each, 7, grid))
