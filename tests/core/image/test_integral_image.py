from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.examples import examples

from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.disc import Grid, Window
from tacshade_edge.core.image import integral_image
from tacshade_edge.core.image.integral_image import BoxSums, CellMeans, Integrator
from tacshade_edge.types import F32, F64, U8, Disc


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


@examples(40)
@given(
    st.integers(1, 40), st.integers(1, 40), st.integers(0, 30), st.integers(1, 5), st.sampled_from([1, 255]),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_box_sums_are_exact(height: int, width: int, half: int, step: int, top: int, seed: int) -> None:
    values = np.random.default_rng(seed).integers(0, top + 1, (height, width), dtype=np.uint8)
    window = Window(3, 5, height, width)
    grid, integrator = Grid.of_window(window, step), Integrator(window, half + 1)
    box_sums = BoxSums(integrator, grid, 2 * half + 1)
    first = integrator.integrate(values)
    box_sums.sums(integrator.integrate(255 - values))  # what comes between does not matter
    found = box_sums.sums(first)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, slow_box(values, 2 * half + 1, grid))


@examples(40)
@given(
    st.integers(1, 30), st.integers(1, 30), st.floats(-20, 40), st.floats(-20, 40), st.floats(0.3, 9),
    st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_means_are_those_of_square_pixels(
    height: int, width: int, row0: float, col0: float, step: float, seed: int
) -> None:
    values = np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)
    grid, integrator = Grid(4, 6, row0, col0, step), Integrator(Window(3, 5, height, width), 2)
    found = CellMeans(integrator, grid).means(integrator.integrate(values))

    def overlap(first: float, count: int, start: int, size: int) -> F64:
        """How much of each pixel (columns) each cell (rows) covers."""
        low = first + step * (np.arange(count)[:, None] - 0.5)
        pixel = start + np.arange(size)[None, :]
        return np.clip(np.minimum(low + step, pixel + 0.5) - np.maximum(low, pixel - 0.5), 0, None)

    exact = overlap(row0, 4, 3, height) @ values.astype(float) @ overlap(col0, 6, 5, width).T / step**2
    np.testing.assert_allclose(found, exact, atol=255e-4 / min(step, 1) ** 2)


def test_an_integral_beyond_int32_is_exact_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(integral_image, "_EXACT", 1000)
    values = np.random.default_rng(2).integers(0, 256, (20, 24), dtype=np.uint8)
    grid, integrator = Grid.of_window(Window(3, 5, 20, 24), 3), Integrator(Window(3, 5, 20, 24), 5)
    box_sums, space = BoxSums(integrator, grid, 7), integrator.space()
    for each in (values, values // 255, values):
        np.testing.assert_array_equal(box_sums.sums(integrator.integrate(each, space)), slow_box(each, 7, grid))


def test_an_integral_image_stays_and_one_in_space_lasts_until_the_next() -> None:
    integrator = Integrator(Window(3, 5, 20, 24), 5)
    one, two = np.zeros((20, 24), np.uint8), np.ones((20, 24), np.uint8)
    kept, space = integrator.integrate(one), integrator.space()
    before, lent = kept.total.tobytes(), integrator.integrate(one, space)
    assert integrator.integrate(two, space).total.base is lent.total.base
    assert kept.total.tobytes() == before != lent.total.tobytes()
    with pytest.raises(ValueError, match="read-only"):
        kept.total[0, 0] = 1


def disc_means(image: U8, disc: Disc) -> F32:
    """Over the cells of the disc's map."""
    integrator = Integrator(Window(0, 0, *image.shape), 0)
    return CellMeans(integrator, disc_map.map_grid(disc)).means(integrator.integrate(image))


def test_averages_keep_the_total_and_say_where_it_is() -> None:
    image = np.zeros((130, 160), dtype=np.uint8)
    image[40, 70] = 200
    cells = disc_means(image, Disc(row_c=61.3, col_c=83.9, radius_px=47.7))
    grid = disc_map.map_grid(Disc(row_c=61.3, col_c=83.9, radius_px=47.7))
    assert cells.sum() * grid.step_px**2 == pytest.approx(200, rel=1e-5)
    rows, cols = np.mgrid[: disc_map.CELLS, : disc_map.CELLS]
    row = (cells * (grid.row0 + grid.step_px * rows)).sum() / cells.sum()
    col = (cells * (grid.col0 + grid.step_px * cols)).sum() / cells.sum()
    assert abs(row - 40) <= grid.step_px
    assert abs(col - 70) <= grid.step_px


def test_a_cell_is_the_exact_mean_of_the_pixels_it_covers() -> None:
    rng = np.random.default_rng(3)
    image = rng.integers(0, 255, (130, 160), dtype=np.uint8)
    # A disc whose cells are exactly a pixel wide, and begin at a pixel's edge.
    disc = Disc(row_c=64.5, col_c=79.5, radius_px=disc_map.CELLS / disc_map.REACH / 2)
    cells = disc_means(image, disc)
    first_row, first_col = round(disc.row_c + 0.5) - disc_map.CELLS // 2, round(disc.col_c + 0.5) - disc_map.CELLS // 2
    n = disc_map.CELLS
    assert disc_map.map_grid(disc).step_px == pytest.approx(1.0)
    np.testing.assert_allclose(cells, image[first_row : first_row + n, first_col : first_col + n], atol=1e-3)


def test_beyond_the_image_is_nothing() -> None:
    image = np.full((60, 60), 255, dtype=np.uint8)
    cells = disc_means(image, Disc(0.0, 0.0, 40.0))
    assert cells[: disc_map.CELLS // 2 - 2].max() == 0
    assert cells[-30:, -30:][0, 0] == pytest.approx(255, rel=1e-4)
