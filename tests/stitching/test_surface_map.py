from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.calibrated_sensor import HALF, calibrated, pressed, step
from tacshade_edge.rigid import shift, turn
from tacshade_edge.stitching import stitcher
from tacshade_edge.stitching.press_points import (
    MIN_CONFIDENCE,
    REST_NS,
    RestDetector,
    height_weight,
    press_points,
)
from tacshade_edge.stitching.stitcher import TILE, SurfaceMap
from tacshade_edge.types import F64, HeightMap

STEP_MM = stitcher.STEP_MM


def cells(x: np.ndarray, y: np.ndarray, z: float | np.ndarray) -> np.ndarray:
    return np.stack((x, y, np.broadcast_to(z, x.shape)), axis=1)


def test_points_on_a_node_are_that_cell_by_their_weights() -> None:
    fused = SurfaceMap()
    fused.add(np.array(((-3.0, 4.5, 1.0),)), np.array((3.0,)))
    fused.add(np.array(((-3.0, 4.5, 2.0),)), np.array((1.0,)))
    assert fused.z_at(np.array(((-2.99, 4.49, 0.0),))) == pytest.approx([1.25])
    raster = fused.raster()
    assert raster.z_mm.shape == (1, 1)
    assert (raster.x0_mm, raster.y0_mm, raster.step_mm) == (-3.0, 4.5, STEP_MM)
    assert raster.z_mm[0, 0] == pytest.approx(1.25)
    np.testing.assert_allclose(raster.points(), ((-3.0, 4.5, 1.25),))


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
    assert np.isnan(fused.z_at(np.array(((10.0, 10.0, 0.0), (200.0, 0.0, 0.0))))).all()


def test_what_was_only_neared_is_not_touched() -> None:
    fused = SurfaceMap()
    fused.add(np.array(((0.0, 0.0, 1.0), (2.0, 0.0, 1.0))), np.array((1.0, 0.01)))
    assert fused.raster().z_mm.shape == (1, 1)
    assert np.isnan(fused.raster(min_weight=5.0).z_mm).all()
    assert SurfaceMap().raster().z_mm.shape == (1, 1)


def test_its_size_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stitcher, "TILES_MAX", 4)
    fused = SurfaceMap()
    tile_mm = stitcher.TILE * STEP_MM
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


FRAME_NS = 33_000_000


def fired(depths: list[float | None]) -> list[int]:
    """Indices of the frames at which a contact came to rest; None is a frame without contact."""
    rest = RestDetector()
    return [
        k for k, d in enumerate(depths) if rest.update(k * FRAME_NS + 1, d is not None, d or 0.0)
    ]


PRESS = [0.2, 0.8, 1.4, 2.0] + [2.0 + 0.01 * (k % 3) for k in range(30)] + [1.2, 0.5]


def test_once_in_each_contact() -> None:
    hits = fired([None, *PRESS, None, None, *PRESS, None])
    assert len(hits) == 2
    assert 4 + REST_NS // FRAME_NS <= hits[0] <= 4 + REST_NS // FRAME_NS + 3
    assert hits[1] - hits[0] == len(PRESS) + 2


def test_what_moves_does_not_come_to_rest() -> None:
    assert fired([0.05 * k for k in range(1, 60)]) == []
    assert fired([2.0 + 0.2 * (k % 2) for k in range(60)]) == []


def test_a_slow_creep_does_not_come_to_rest() -> None:
    # 0.6 mm/s
    assert fired([1.0 + 0.02 * k for k in range(100)]) == []


@pytest.mark.slow
def test_the_points_are_the_contacts() -> None:
    result = step("accurate", pressed("ball", 3.0).image)
    touch = press_points(result.height, calibrated().geometry)
    # The cloud is ordered by object; of one object both go row by row.
    np.testing.assert_allclose(touch.points_mm, result.cloud.points_mm, atol=1e-5)
    assert touch.confidence.min() == pytest.approx(MIN_CONFIDENCE, abs=0.4)
    assert touch.confidence.max() == 1
    # The middle of the contact has more confidence than its outline.
    rho = np.hypot(*touch.points_mm[:, :2].T)
    assert touch.confidence[rho < 1].min() > touch.confidence[rho > np.percentile(rho, 95)].max()


def test_wide_cells_are_divided() -> None:
    # The same skin on cells of 0.2 and of 0.8 mm, four of them as one.
    geometry = calibrated().geometry
    fine_px = 0.2 / geometry.mm_per_px
    rows, cols = np.mgrid[:64, :64]
    inside = np.hypot(rows - 31.5, cols - 31.5) < 24
    dent = np.maximum(0, 2 - 0.003 * ((rows - 31.5) ** 2 + (cols - 31.5) ** 2)).astype(np.float32)
    first = (geometry.disc.row_c - 31.5 * fine_px, geometry.disc.col_c - 31.5 * fine_px)
    fine = press_points(HeightMap(dent, inside, *first, fine_px), geometry)
    blocks = dent.reshape(16, 4, 16, 4).mean(axis=(1, 3)), inside[1::4, 1::4].copy()
    wide = press_points(
        HeightMap(*blocks, first[0] + 1.5 * fine_px, first[1] + 1.5 * fine_px, 4 * fine_px),
        geometry,
    )
    assert len(wide.points_mm) == pytest.approx(
        9 * np.count_nonzero(blocks[1])
    )  # 0.8 mm into three
    assert len(fine.points_mm) == np.count_nonzero(inside)
    middle = np.hypot(*wide.points_mm[:, :2].T) < 3
    for point in wide.points_mm[middle][::17]:
        nearest = fine.points_mm[np.argmin(np.linalg.norm(fine.points_mm - point, axis=1))]
        assert abs(nearest[2] - point[2]) < 0.1
        assert np.hypot(*(nearest - point)[:2]) < 0.15


def test_normals_are_the_skins() -> None:
    geometry = calibrated().geometry
    flat = np.zeros((60, 60), np.float32)
    contact = np.zeros((60, 60), bool)
    contact[20:40, 20:40] = True
    step_px = geometry.disc.radius_px / 40
    height = HeightMap(
        flat,
        contact,
        geometry.disc.row_c - 30 * step_px,
        geometry.disc.col_c - 30 * step_px,
        step_px,
    )
    touch = press_points(height, geometry)
    # Undeformed skin is the sphere.
    np.testing.assert_allclose(touch.normals, touch.points_mm / HALF.skin_radius_mm, atol=0.01)


@pytest.mark.slow
def test_steep_places_say_little_of_height() -> None:
    touch = press_points(step("accurate", pressed("ball", 3.0).image).height, calibrated().geometry)
    upright = height_weight(touch, shift(1, 2, 3))
    assert (upright <= touch.confidence + 1e-6).all()
    middle = int(np.argmin(np.hypot(*touch.points_mm[:, :2].T)))
    assert upright[middle] > 0.9
    tilted = height_weight(touch, turn((0.7, 0, 0)))  # 40 degrees
    assert tilted[middle] < 0.1 * upright[middle]
    over = height_weight(touch, turn((np.pi, 0, 0)))  # looking down
    np.testing.assert_allclose(over, upright, atol=1e-6)


def test_a_press_takes_no_more_on_a_large_map() -> None:
    taken = []
    for tiles in (1, 900):
        surface = SurfaceMap()
        for k in range(tiles):
            surface.add(at_tile(*divmod(k, 30)), np.ones(1))
        tracemalloc.start()
        surface.add(at_tile(30, 0), np.ones(1))
        taken.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert surface.tiles == tiles + 1
    assert taken[1] < taken[0] + 4096


def at_tile(row: int, col: int) -> F64:
    return np.array([((col + 0.5) * TILE * STEP_MM, (row + 0.5) * TILE * STEP_MM, 0.0)])
