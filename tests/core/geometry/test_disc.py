from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.geometry.disc import Grid, Window, cells_in_image, disc_mask, disc_rays, radius_squared
from tacshade_edge.simulator.render import project
from tacshade_edge.simulator.truth import pixel_rays
from tacshade_edge.types import Disc, Geometry

CAMERAS = [None, 4.0, 14.0, 60.0]


@given(st.integers(1, 50), st.integers(1, 50), st.floats(-60, 90), st.floats(-60, 90), st.floats(0, 60))
def test_a_window_holds_the_disc_and_lies_in_the_image(
    height: int, width: int, row_c: float, col_c: float, radius: float
) -> None:
    disc = Disc(row_c, col_c, radius)
    window, mask = Window.of_disc(height, width, disc), disc_mask(height, width, disc)
    assert window.rows > 0
    assert window.cols > 0
    assert window.cut(mask).shape == (window.rows, window.cols)
    assert window.cut(mask).sum() == mask.sum()
    assert max(window.rows, window.cols) <= 2 * radius + 3


@given(st.integers(0, 30), st.integers(0, 30), st.integers(1, 50), st.integers(1, 50), st.integers(1, 8))
def test_a_grid_lies_in_its_window_and_covers_it(row0: int, col0: int, rows: int, cols: int, step: int) -> None:
    grid = Grid.of_window(Window(row0, col0, rows, cols), step)
    for first, count, begin, size in ((grid.row0, grid.rows, row0, rows), (grid.col0, grid.cols, col0, cols)):
        last = first + step * (count - 1)
        assert begin <= first <= last < begin + size
        assert max(first - begin, begin + size - 1 - last) < step
        if size >= step:  # whatever the window, the same pixels of the image
            assert first % step == step // 2


@given(st.integers(1, 50), st.integers(1, 50), st.integers(1, 8))
def test_every_cell_of_an_image_grid_is_in_the_image(height: int, width: int, step: int) -> None:
    assert cells_in_image(Grid.of_window(Window(0, 0, height, width), step), height, width).all()


def test_cells_beyond_the_image_are_not_in_it() -> None:
    seen = cells_in_image(Grid(4, 5, -1.6, -0.4, 1.3), 3, 5)  # rows -1.6, -0.3, 1.0, 2.3; columns -0.4 ... 4.8
    np.testing.assert_array_equal(seen.any(axis=1), [False, True, True, True])
    np.testing.assert_array_equal(seen.any(axis=0), [True, True, True, True, False])


def test_the_mask_holds_the_pixels_whose_centre_is_in_the_circle() -> None:
    mask = disc_mask(7, 9, Disc(3.0, 4.0, 2.0))
    expected = np.array([[(r - 3) ** 2 + (c - 4) ** 2 <= 4 for c in range(9)] for r in range(7)])
    np.testing.assert_array_equal(mask, expected)
    assert not disc_mask(7, 9, Disc(100.0, 100.0, 2.0)).any()


def test_the_rim_is_at_one_and_the_centre_at_zero() -> None:
    rho2 = radius_squared(Grid(11, 11, 0.0, 0.0, 1.0), Disc(5.0, 5.0, 5.0))
    assert rho2[5, 5] == 0
    assert rho2[5, 10] == rho2[0, 5] == 1


@pytest.mark.parametrize("distance_mm", CAMERAS)
def test_the_visible_circle_is_where_the_half_angle_is_seen(distance_mm: float | None) -> None:
    geometry = Geometry(20.0, distance_mm, 50.0, Disc(118.0, 163.0, 100.0))
    theta = np.radians(50.0)
    for angle in (0.0, 1.0, 3.0):
        along = np.array([np.sin(theta) * np.cos(angle), np.sin(theta) * np.sin(angle), np.cos(theta)])
        col, row = project(geometry, 20.0 * along)
        assert np.hypot(row - 118.0, col - 163.0) == pytest.approx(100.0, abs=1e-9)


@pytest.mark.parametrize("distance_mm", CAMERAS)
def test_rays_are_those_of_the_independent_camera(distance_mm: float | None) -> None:
    geometry = Geometry(20.0, distance_mm, 50.0, Disc(118.3, 163.6, 102.4))
    grid = Grid.of_window(Window(0, 0, 240, 320), 4)
    rays = disc_rays(grid, geometry)
    rows, cols = (v.ravel().astype(float) for v in np.mgrid[2:240:4, 2:320:4])
    origin, along = pixel_rays(geometry, rows, cols)
    if distance_mm is None:
        u, v = origin[:, 0], origin[:, 1]
    else:
        u, v = along[:, 0] / along[:, 2], along[:, 1] / along[:, 2]
    np.testing.assert_allclose(rays.u.ravel(), u, atol=2e-6)
    np.testing.assert_allclose(rays.v.ravel(), v, atol=2e-6)
    np.testing.assert_array_equal(rays.inside.ravel(), np.hypot(rows - 118.3, cols - 163.6) <= 102.4)
    assert rays.inside.shape == rays.u.shape == rays.v.shape == (60, 80)
