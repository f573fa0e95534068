import numpy as np
import pytest

from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.back_projection import skin_points
from tacshade_edge.core.geometry.disc import disc_rays
from tacshade_edge.types import Disc, Geometry

DISC = Disc(row_c=61.3, col_c=83.9, radius_px=47.7)


def test_the_square_holds_the_disc_and_its_cells_tile_it() -> None:
    grid = disc_map.map_grid(DISC)
    assert grid.rows == grid.cols == disc_map.CELLS
    reach = disc_map.REACH * DISC.radius_px
    assert grid.row0 - grid.step_px / 2 == pytest.approx(DISC.row_c - reach)
    assert grid.col0 + (grid.cols - 0.5) * grid.step_px == pytest.approx(DISC.col_c + reach)


def test_averages_keep_the_total_and_say_where_it_is() -> None:
    image = np.zeros((130, 160), dtype=np.uint8)
    image[40, 70] = 200
    cells = disc_map.disc_average(image, DISC)
    grid = disc_map.map_grid(DISC)
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
    cells = disc_map.disc_average(image, disc)
    first_row, first_col = round(disc.row_c + 0.5) - disc_map.CELLS // 2, round(disc.col_c + 0.5) - disc_map.CELLS // 2
    n = disc_map.CELLS
    assert disc_map.map_grid(disc).step_px == pytest.approx(1.0)
    np.testing.assert_allclose(cells, image[first_row : first_row + n, first_col : first_col + n], atol=1e-3)


def test_beyond_the_image_is_nothing() -> None:
    image = np.full((60, 60), 255, dtype=np.uint8)
    cells = disc_map.disc_average(image, Disc(0.0, 0.0, 40.0))
    assert cells[: disc_map.CELLS // 2 - 2].max() == 0
    assert cells[-30:, -30:][0, 0] == pytest.approx(255, rel=1e-4)


@pytest.mark.parametrize("distance", [None, 8.0, 14.0, 30.0])
def test_what_is_known_agrees_with_the_camera(distance: float | None) -> None:
    geometry = Geometry(20.0, distance, 50.0, DISC)
    known = disc_map.geometry_maps(geometry, 6.0)
    x, y, gain_x, _, cosine, pitch = known
    grid = disc_map.map_grid(DISC)
    rays = disc_rays(grid, geometry)
    row, col = 40, 75
    assert rays.inside[row, col]
    points = skin_points(np.zeros(rays.inside.shape, dtype=np.float32), rays, geometry)
    point = points[row, col].astype(float)
    camera = np.array((0.0, 0.0, -(distance or 1e9)))
    ray = (point - camera) / np.linalg.norm(point - camera)
    assert cosine[row, col] == pytest.approx(ray @ point / 20.0, abs=2e-3)
    assert x[row, col] == pytest.approx((grid.col0 + grid.step_px * col - DISC.col_c) / DISC.radius_px, abs=1e-6)
    assert y[row, col] == pytest.approx((grid.row0 + grid.step_px * row - DISC.row_c) / DISC.radius_px, abs=1e-6)
    assert pitch[0, 0] == pytest.approx(60 / DISC.radius_px)
    moved = point - (0, 0, 0.01)
    if distance is None:
        assert gain_x[row, col] == 0
    else:
        shift_px = geometry.f_px * (moved[0] / (moved[2] + distance) - point[0] / (point[2] + distance))
        unit_mm = 20 * np.sin(np.radians(50))
        assert gain_x[row, col] == pytest.approx(shift_px / DISC.radius_px / 0.01 * unit_mm, rel=5e-3)
