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
