"""Eq. 1 and all before it: checkerboards of every period, discs of any size, and images too large for int32 sums."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.built_sensor import built_calibration
from support.examples import examples
from support.extremes import EXTREME_IMAGES, checkerboard, makers

from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.disc import Grid, Window, disc_mask
from tacshade_edge.core.image.greyscale import white_ratio
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.image.white import BoxSums, CellMeans, Integrator, binarise
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.types import F64, U8, Binarisation, Disc

ROWS, COLS = 96, 128
DISC = Disc(47.3, 64.8, 42.0)
# Float32 holds the sums of a window exactly; one product and one quotient round.
BOUND = 255 * 2e-7


def plain_ratio(white: U8, mask: U8, grid: Grid, side_px: int) -> F64:
    """Eq. 1 in float64, by an integral image of its own."""

    def sums(values: U8) -> F64:
        half = side_px // 2
        total = np.pad(values.astype(np.float64), half).cumsum(0).cumsum(1)
        total = np.pad(total, ((1, 0), (1, 0)))
        row = (int(grid.row0) + int(grid.step_px) * np.arange(grid.rows))[:, None]
        col = (int(grid.col0) + int(grid.step_px) * np.arange(grid.cols))[None, :]
        low, high = 0, side_px
        return (
            total[row + high, col + high]
            - total[row + low, col + high]
            - total[row + high, col + low]
            + total[row + low, col + low]
        )

    inside = sums(mask)
    return np.divide(255 * sums(white), inside, out=np.zeros_like(inside), where=inside > 0)


@pytest.mark.slow
@pytest.mark.parametrize("side_px", [1, 17, 255])
@pytest.mark.parametrize("radius_px", [0.5, 3.0, 42.0, 300.0])
def test_every_period_has_its_ratio(side_px: int, radius_px: float) -> None:
    disc = Disc(DISC.row_c, DISC.col_c, radius_px)
    mask = disc_mask(ROWS, COLS, disc).astype(np.uint8)
    window = Window(0, 0, ROWS, COLS)
    grid, integrator = Grid.of_window(window, 3), Integrator(window, side_px // 2 + 1)
    box_sums = BoxSums(integrator, grid, side_px)
    total = box_sums.sums(integrator.integrate(mask))
    for period in range(2, 130):
        white = checkerboard(period)(ROWS, COLS) // 255 * mask
        g = white_ratio(box_sums.sums(integrator.integrate(white)), total)
        np.testing.assert_allclose(g, plain_ratio(white, mask, grid, side_px), atol=BOUND)
        assert (g >= 0).all()
        assert (g <= 255).all()


@pytest.mark.slow
@given(maker=makers(), method=st.sampled_from(get_args(Binarisation)), pitch_px=st.floats(0.3, 300))
@examples(100)
def test_any_image_is_black_and_white_inside_the_disc_and_black_outside(
    maker: object, method: Binarisation, pitch_px: float
) -> None:
    mask = disc_mask(ROWS, COLS, DISC).astype(np.uint8)
    image = np.ascontiguousarray(maker(ROWS, COLS))  # type: ignore[operator]
    white = binarise(image, mask, method, pitch_px).copy()
    assert white.max() <= 1
    assert not white[mask == 0].any()
    outside_changed = np.where(mask > 0, image, 255 - image)
    assert np.array_equal(binarise(outside_changed, mask, method, pitch_px), white)


@pytest.mark.parametrize("profile", PROFILES)
def test_every_extreme_image_has_ratios(profile: str) -> None:
    preprocessor = Preprocessor(built_calibration(ROWS, COLS, disc=DISC, pitch_px=8.0), PROFILES[profile])
    cells_of = CellMeans(preprocessor.integrator, disc_map.map_grid(DISC))
    for image in EXTREME_IMAGES.values():
        found = preprocessor.preprocess(np.ascontiguousarray(image(ROWS, COLS)))
        g, cells = preprocessor.ratio(found.white), cells_of.means(found.white)
        assert 0 <= found.unseen <= 1
        assert np.isfinite(g).all()
        assert (g >= 0).all()
        assert (g <= 255 * (1 + 1e-6)).all()
        assert (cells >= -1e-4).all()
        assert (cells <= 1 + 1e-4).all()


@pytest.mark.slow
@pytest.mark.parametrize("level", [1, 255])
def test_the_largest_image_has_exact_means(level: int) -> None:
    """4096x3072 of 255 is more than int32 holds."""
    disc = Disc(1535.5, 2047.5, 1535.0)
    rng = np.random.default_rng(1)
    values = rng.integers(0, level + 1, (3072, 4096), np.uint8)
    grid, integrator = disc_map.map_grid(disc), Integrator(Window(0, 0, 3072, 4096), 0)
    found = CellMeans(integrator, grid).means(integrator.integrate(values))
    step = grid.step_px
    total = np.pad(values.astype(np.float64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))

    def edges(first: float, count: int, size: int) -> F64:
        return np.clip(first + step * (np.arange(count + 1) - 0.5) + 0.5, 0, size)

    def at(axis_values: F64, edge: F64) -> F64:
        low = np.minimum(edge.astype(int), len(axis_values) - 2)
        part = (edge - low)[:, None]
        return axis_values[low] * (1 - part) + axis_values[low + 1] * part

    rows = np.diff(at(total, edges(grid.row0, grid.rows, 3072)), axis=0)
    both = np.diff(at(rows.T.copy(), edges(grid.col0, grid.cols, 4096)), axis=0).T
    off = float(np.abs(found - both / step**2).max()) / level
    print(f"figure: means over the network's cells of a 4096x3072 image up to {level}: {off:.0e} of it off at most")
    assert off < 1e-4
