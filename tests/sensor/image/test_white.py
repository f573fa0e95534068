from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from support.examples import examples
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import Grid, Window, disc_mask
from tacshade_edge.sensor.image import white as white_module
from tacshade_edge.sensor.image.white import (
    ADAPTIVE_FLOOR,
    Binariser,
    BoxSums,
    CellMeans,
    Integrator,
    binarise,
    halved,
    level_at,
    median,
    odd,
    padded,
)
from tacshade_edge.types import F32, F64, U8, Binarisation, Disc

THRESHOLD_LSB = 2
"""How far off the uint8 threshold may be; the docstring of `Binariser` says so."""


def exact_threshold(grey: U8, mask: U8, pitch_px: float) -> F64:
    """The adaptive threshold in float64, pixel by pixel:
    block means, box means of them, linear between.
    """
    size = tuple(-(-n // 4) * 4 for n in grey.shape)
    inside, masked = np.zeros(size), np.zeros(size)
    inside[: grey.shape[0], : grey.shape[1]] = mask
    masked[: grey.shape[0], : grey.shape[1]] = grey * (mask > 0)

    def blocks(values: F64) -> F64:
        return np.asarray(
            values.reshape(size[0] // 4, 4, size[1] // 4, 4).mean(axis=(1, 3)), np.float64
        )

    weight = (blocks(inside) == 1).astype(float)
    white = blocks(masked) * weight
    half = odd(pitch_px) // 2
    local = np.zeros_like(white)
    for i, j in np.ndindex(*white.shape):
        box = slice(max(i - half, 0), i + half + 1), slice(max(j - half, 0), j + half + 1)
        local[i, j] = white[box].sum() / max(weight[box].sum(), 1)
    local = np.maximum(local, ADAPTIVE_FLOOR * white.sum() / max(weight.sum(), 1))

    def along(values: F64, count: int) -> F64:
        at = np.clip((np.arange(count) + 0.5) / 4 - 0.5, 0, len(values) - 1)
        low = np.minimum(at.astype(int), max(len(values) - 2, 0))
        high = np.minimum(low + 1, len(values) - 1)
        part = (at - low)[:, None]
        return np.asarray(values[low] * (1 - part) + values[high] * part)

    exact = along(along(local, size[0]).T, size[1]).T
    return exact[: grey.shape[0], : grey.shape[1]]


@settings(deadline=None)
@given(
    st.integers(1, 45),
    st.integers(1, 45),
    st.builds(Disc, st.floats(-10, 50), st.floats(-10, 50), st.floats(1, 40)),
    st.floats(1, 20),
    st.sampled_from(["noise", "checkerboard", "step", "constant", "extremes"]),
    st.integers(0, 2**32 - 1),
)
def test_the_threshold_is_the_exact_one_within_its_bound(
    height: int, width: int, disc: Disc, pitch: float, kind: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    mask = disc_mask(height, width, disc).astype(np.uint8)
    rows, cols = np.indices((height, width))
    grey = {
        "noise": rng.integers(0, 256, mask.shape),
        "checkerboard": 255 * ((rows // (1 + seed % 7) + cols // (1 + seed % 7)) % 2),
        "step": np.where(cols > width / 2, 255, 3),
        "constant": np.full(mask.shape, seed % 256),
        "extremes": 255 * rng.integers(0, 2, mask.shape),
    }[kind].astype(np.uint8)
    binariser = Binariser(mask, "adaptive", pitch)
    binariser(255 - grey)  # what comes before does not matter
    white = binariser(grey)
    assert not white[mask == 0].any()
    assert set(np.unique(white)) <= {0, 1}
    if not mask.any():
        return
    above = grey - exact_threshold(grey, mask, pitch)
    sure = (mask > 0) & (np.abs(above) > THRESHOLD_LSB)
    np.testing.assert_array_equal(white[sure] > 0, above[sure] > 0)


@given(st.integers(1, 20), st.integers(1, 20), st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_padding_adds_below_and_right_and_halving_rounds_half_up(
    rows: int, cols: int, by: int, seed: int
) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (rows, cols), dtype=np.uint8)
    whole = padded(image, by, 7)
    assert whole.shape[0] % by == whole.shape[1] % by == 0
    assert max(whole.shape[0] - rows, whole.shape[1] - cols) < by
    np.testing.assert_array_equal(whole[:rows, :cols], image)
    assert (whole[rows:] == 7).all()
    even = padded(image, 2, 0).astype(int)
    exact = (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2] + 2) // 4
    np.testing.assert_array_equal(halved(even.astype(np.uint8)), exact)


def test_an_odd_window_is_the_nearest() -> None:
    assert [odd(v) for v in (-3, 0, 0.4, 1, 1.9, 2.1, 3, 18.9, 37.92)] == [
        1,
        1,
        1,
        1,
        1,
        3,
        3,
        19,
        37,
    ]


@pytest.mark.parametrize("method", ["adaptive", "global", "otsu"])
def test_markers_are_white_and_the_outside_is_not(method: Binarisation) -> None:
    grey = np.full((60, 60), 20, np.uint8)
    for row in range(5, 60, 10):
        for col in range(5, 60, 10):
            cv2.circle(grey, (col, row), 2, 200, -1)
    mask = disc_mask(60, 60, Disc(30, 30, 25)).astype(np.uint8)
    bright = np.where(mask > 0, grey, 255).astype(np.uint8)
    np.testing.assert_array_equal(binarise(bright, mask, method, 10.0), (grey > 100) * mask)


@pytest.mark.parametrize("method", ["adaptive", "global", "otsu"])
@pytest.mark.parametrize("level", [0, 128, 255])
def test_a_constant_has_one_colour(method: Binarisation, level: int) -> None:
    mask = disc_mask(40, 40, Disc(20, 20, 15)).astype(np.uint8)
    white = binarise(np.full((40, 40), level, np.uint8), mask, method, 8.0)
    assert not white[mask == 0].any()
    assert len(np.unique(white[mask > 0])) == 1
    assert not binarise(np.full((40, 40), level, np.uint8), 0 * mask, method, 8.0).any()


def test_adaptive_survives_light_that_global_does_not() -> None:
    flat = np.full((120, 120), 0.2)
    for row in range(5, 120, 10):
        for col in range(5, 120, 10):
            cv2.circle(flat, (col, row), 3, 1.0, -1)
    lit = (flat * np.linspace(45, 250, 120)[None, :]).astype(np.uint8)
    mask = np.ones((120, 120), np.uint8)
    wrong = {
        m: np.mean(binarise(lit, mask, m, 10.0) != (flat > 0.5)) for m in ("adaptive", "global")
    }
    assert wrong["adaptive"] < 0.002
    assert wrong["global"] > 0.015


@given(hnp.arrays(np.float32, st.integers(1, 50), elements=st.floats(-1e6, 1e6, width=32)))
def test_the_median_is_numpys(values: F32) -> None:
    assert median(values) == np.median(values.astype(np.float64))


@given(hnp.arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9))), st.floats(0.01, 1))
def test_a_level_is_that_below_which_a_part_lies(values: U8, part: float) -> None:
    mask = np.where(values % 3 > 0, np.uint8(255), np.uint8(0))
    inside = np.sort(values[mask > 0])
    expected = inside[max(int(np.ceil(part * inside.size - 1e-6)) - 1, 0)] if inside.size else 0
    assert level_at(values, mask, part) == expected


def slow_box(values: U8, window: int, grid: Grid) -> F64:
    """Sum over the part of each box that lies in the window, which begins at row 3 and column 5,
    in float64.
    """
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
    st.integers(1, 40),
    st.integers(1, 40),
    st.integers(0, 30),
    st.integers(1, 5),
    st.sampled_from([1, 255]),
    st.integers(0, 2**32 - 1),
)
def test_box_sums_are_exact(
    height: int, width: int, half: int, step: int, top: int, seed: int
) -> None:
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
    st.integers(1, 30),
    st.integers(1, 30),
    st.floats(-20, 40),
    st.floats(-20, 40),
    st.floats(0.3, 9),
    st.integers(0, 2**32 - 1),
)
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

    exact = (
        overlap(row0, 4, 3, height) @ values.astype(float) @ overlap(col0, 6, 5, width).T / step**2
    )
    np.testing.assert_allclose(found, exact, atol=255e-4 / min(step, 1) ** 2)


def test_an_integral_beyond_int32_is_exact_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(white_module, "_EXACT", 1000)
    values = np.random.default_rng(2).integers(0, 256, (20, 24), dtype=np.uint8)
    grid, integrator = Grid.of_window(Window(3, 5, 20, 24), 3), Integrator(Window(3, 5, 20, 24), 5)
    box_sums, space = BoxSums(integrator, grid, 7), integrator.space()
    for each in (values, values // 255, values):
        np.testing.assert_array_equal(
            box_sums.sums(integrator.integrate(each, space)), slow_box(each, 7, grid)
        )


def test_an_integral_in_space_lasts_until_the_next() -> None:
    integrator = Integrator(Window(3, 5, 20, 24), 5)
    one, two = np.zeros((20, 24), np.uint8), np.ones((20, 24), np.uint8)
    kept, space = integrator.integrate(one), integrator.space()
    lent = integrator.integrate(one, space)
    assert np.shares_memory(integrator.integrate(two, space), lent)
    assert not kept.any()
    assert lent.any()


def test_a_cell_is_the_exact_mean_of_the_pixels_it_covers() -> None:
    rng = np.random.default_rng(3)
    image = rng.integers(0, 255, (130, 160), dtype=np.uint8)
    # A disc whose cells are exactly a pixel wide, and begin at a pixel's edge.
    disc = Disc(row_c=64.5, col_c=79.5, radius_px=disc_map.CELLS / disc_map.REACH / 2)
    integrator = Integrator(Window(0, 0, *image.shape), 0)
    cells = CellMeans(integrator, disc_map.map_grid(disc)).means(integrator.integrate(image))
    first_row, first_col = (
        round(disc.row_c + 0.5) - disc_map.CELLS // 2,
        round(disc.col_c + 0.5) - disc_map.CELLS // 2,
    )
    n = disc_map.CELLS
    assert disc_map.map_grid(disc).step_px == pytest.approx(1.0)
    np.testing.assert_allclose(
        cells, image[first_row : first_row + n, first_col : first_col + n], atol=1e-3
    )
