import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.core.stitching import surface_map
from tacshade_edge.core.stitching.surface_map import SurfaceMap

STEP_MM = surface_map.STEP_MM


def cells(x: np.ndarray, y: np.ndarray, z: float | np.ndarray) -> np.ndarray:
    return np.stack((x, y, np.broadcast_to(z, x.shape)), axis=1)


def test_a_point_on_a_node_is_that_cell() -> None:
    fused = SurfaceMap()
    fused.add(np.array(((-3.0, 4.5, 1.25),)), np.ones(1))
    raster = fused.raster()
    assert raster.z_mm.shape == (1, 1)
    assert (raster.x0_mm, raster.y0_mm, raster.step_mm) == (-3.0, 4.5, STEP_MM)
    assert raster.z_mm[0, 0] == pytest.approx(1.25)
    np.testing.assert_allclose(raster.points(), ((-3.0, 4.5, 1.25),))


def test_weights_are_the_means() -> None:
    fused = SurfaceMap()
    fused.add(np.array(((0.0, 0.0, 1.0),)), np.array((3.0,)))
    fused.add(np.array(((0.0, 0.0, 2.0),)), np.array((1.0,)))
    assert fused.heights().z_at(np.array(((0.01, -0.01, 0.0),))) == pytest.approx([1.25])


@given(st.floats(-300, 300), st.floats(-300, 300), st.floats(-5, 5))
@settings(max_examples=20)
def test_a_plane_comes_back_anywhere(x0: float, y0: float, z: float) -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 4, (2, 5000))
    fused = SurfaceMap()
    fused.add(cells(x0 + x, y0 + y, z), np.ones(5000))
    raster = fused.raster()
    assert raster.z_mm.shape == pytest.approx((4 / STEP_MM + 1,) * 2, abs=1)
    np.testing.assert_allclose(raster.z_mm[1:-1, 1:-1], z, atol=1e-5)
    assert abs(raster.x0_mm - x0) <= STEP_MM
    assert abs(raster.y0_mm - y0) <= STEP_MM


def test_holes_stay_holes() -> None:
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0, 20, STEP_MM), np.arange(0, 20, STEP_MM)))
    hole = np.hypot(x - 10, y - 10) < 4
    fused = SurfaceMap()
    fused.add(cells(x[~hole], y[~hole], 1.0), np.ones(np.count_nonzero(~hole)))
    z = fused.raster().z_mm
    np.testing.assert_array_equal(np.isnan(z.ravel()), hole)
    assert np.isnan(fused.heights().z_at(np.array(((10.0, 10.0, 0.0), (200.0, 0.0, 0.0))))).all()


def test_a_slope_is_not_shifted() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-10, 10, (2, 60000))
    fused = SurfaceMap()
    fused.add(cells(x, y, 0.2 * x - 0.1 * y), np.ones(x.size))
    points = fused.raster().points()
    inner = np.abs(points[:, :2]).max(axis=1) < 9.5
    error = points[inner, 2] - 0.2 * points[inner, 0] + 0.1 * points[inner, 1]
    assert np.abs(error).max() < 0.03


def test_what_was_only_neared_is_not_touched() -> None:
    fused = SurfaceMap()
    fused.add(np.array(((0.0, 0.0, 1.0), (2.0, 0.0, 1.0))), np.array((1.0, 0.01)))
    assert fused.raster().z_mm.shape == (1, 1)
    assert np.isnan(fused.raster(min_weight=5.0).z_mm).all()
    assert SurfaceMap().raster().z_mm.shape == (1, 1)


def test_its_size_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surface_map, "TILES_MAX", 4)
    fused = SurfaceMap()
    tile_mm = surface_map.TILE * STEP_MM
    for k in range(4):
        fused.add(np.array(((k * tile_mm + 1, 1.0, 0.0),)), np.ones(1))
    before = fused.raster().z_mm.copy()
    with pytest.raises(ValueError, match="exceed 4 tiles"):
        fused.add(np.array(((1.0, 1.0, 9.0), (1.0, 5 * tile_mm, 0.0))), np.ones(2))
    np.testing.assert_array_equal(fused.raster().z_mm, before)  # nothing was added
    assert fused.tiles == 4


def test_a_press_far_from_the_others_is_refused() -> None:
    fused = SurfaceMap()
    fused.add(np.array(((0.0, 0.0, 1.0),)), np.ones(1))
    with pytest.raises(ValueError, match="a pose is far from the others"):
        fused.add(np.array(((2000.0, 2000.0, 1.0),)), np.ones(1))
    fused.add(np.array(((2000.0, 3.0, 1.0),)), np.ones(1))  # a long strip is no large raster
    assert fused.raster().z_mm.shape == (13, 8001)
    assert fused.tiles == 2


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e12])
def test_a_point_that_is_none_is_refused(bad: float) -> None:
    fused = SurfaceMap()
    with pytest.raises(ValueError, match="not finite"):
        fused.add(np.array(((0.0, bad, 0.0),)), np.ones(1))
    assert fused.tiles == 0
