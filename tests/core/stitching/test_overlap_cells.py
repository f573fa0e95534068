import numpy as np
import pytest

from tacshade_edge.core.stitching.overlap_cells import overlap_cells


def test_points_of_a_plane_agree_in_every_cell() -> None:
    x, y = np.random.default_rng(0).uniform(-10, 10, (2, 4000))
    at = np.stack((x, y, 3 + 0.2 * x - 0.1 * y), axis=1)
    cells = overlap_cells(at, np.ones(len(at)), 1.0)
    inside = (np.abs(at[:, :2]) < 8).all(axis=1)
    assert cells.slope[inside] == pytest.approx(np.broadcast_to((0.2, -0.1), (inside.sum(), 2)), abs=0.1)
    mean = cells.means(cells.height_mm, np.ones(len(at)))
    assert np.abs(cells.height_mm - mean[cells.of_point])[inside].max() < 0.1
    assert cells.count == 400


def test_a_step_is_no_slope_beyond_two() -> None:
    at = np.array(((0.5, 0.5, 0.0), (1.5, 0.5, 100.0)))
    assert overlap_cells(at, np.ones(2), 1.0).slope[:, 0] == pytest.approx((2.0, 2.0))
