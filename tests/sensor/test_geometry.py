from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.calibration.reference.rim import rim_seen
from tacshade_edge.lab.simulator.render import project
from tacshade_edge.lab.simulator.truth import pixel_rays
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import (
    DiscRays,
    Grid,
    Window,
    cell_area_mm2,
    cells_in_image,
    disc_mask,
    disc_rays,
    labels_by_cell,
    radius_squared,
    skin_planes,
    skin_points,
)
from tacshade_edge.types import Disc, Geometry

DISC = Disc(118.3, 163.6, 102.4)


def rays_of(u: list[float], v: list[float]) -> DiscRays:
    return DiscRays(np.ones(len(u), bool), np.array(u, np.float32), np.array(v, np.float32))


@given(
    st.none() | st.floats(2.0, 60.0),
    st.floats(10.0, 40.0),
    st.floats(0.0, 0.95),
    st.floats(0.0, 60.0),
    st.floats(0.0, 2 * math.pi),
)
def test_a_seen_skin_point_comes_back(
    d_mm: float | None, r_mm: float, part: float, polar: float, turn: float
) -> None:
    h_mm = part * r_mm
    theta = math.radians(polar)
    normal = np.array(
        [math.sin(theta) * math.cos(turn), math.sin(theta) * math.sin(turn), math.cos(theta)]
    )
    point = (r_mm - h_mm) * normal
    geometry = Geometry(r_mm, d_mm, 50.0, DISC)
    col, row = project(geometry, point)
    rays = disc_rays(Grid(1, 1, float(row), float(col), 1.0), geometry)
    found = skin_points(np.full((1, 1), h_mm, np.float32), rays, geometry)
    np.testing.assert_allclose(found[0, 0], point, atol=1e-3)


@pytest.mark.parametrize("d_mm", [None, 14.0])
def test_a_height_out_of_the_rays_reach_is_guarded(d_mm: float | None) -> None:
    geometry = Geometry(20.0, d_mm, 50.0, DISC)
    slope = 15.0 if d_mm is None else 0.5
    heights = np.array([0, 18, 20, np.nan], np.float32)
    found = skin_points(heights, rays_of([slope] * 4, [0] * 4), geometry)
    assert np.isfinite(found).all(axis=1).tolist() == [True, True, True, False]
    if d_mm is not None:  # the foot of the perpendicular from O on the ray
        foot = d_mm * 0.5 / 1.25
        np.testing.assert_allclose(found[1], [foot, 0, foot / 0.5 - d_mm], atol=1e-4)
    assert np.linalg.norm(found[0]) == pytest.approx(20, abs=1e-4)


@pytest.mark.parametrize("d_mm", [None, 14.0])
def test_cells_add_up_to_the_spherical_cap(d_mm: float | None) -> None:
    geometry = Geometry(20.0, d_mm, 50.0, DISC)
    rays = disc_rays(Grid(240, 320, 0.0, 0.0, 1.0), geometry)
    height = np.where(rays.inside, np.float32(0), np.float32(np.nan))
    area = cell_area_mm2(skin_planes(height, rays, geometry))
    cap = 2 * math.pi * 20.0**2 * (1 - math.cos(math.radians(50.0)))
    assert float(np.nansum(area)) == pytest.approx(cap, rel=0.04)  # the rim's cells have no area
    assert area[0, 0] == 0
    assert np.isfinite(area).all()


def test_areas_are_those_of_plain_gradients() -> None:
    points = np.random.default_rng(3).normal(size=(7, 9, 3)).astype(np.float32)
    points[2, 3] = np.nan
    du, dv = np.gradient(points, axis=1), np.gradient(points, axis=0)
    expected = np.linalg.norm(np.cross(du, dv), axis=-1)
    assert np.isnan(expected).sum() == 4
    np.testing.assert_array_equal(
        cell_area_mm2(np.moveaxis(points, -1, 0)), np.nan_to_num(expected)
    )


def test_a_line_of_points_has_no_area() -> None:
    assert cell_area_mm2(np.zeros((3, 1, 5), np.float32)).tolist() == [[0.0] * 5]
    assert cell_area_mm2(np.zeros((3, 1, 1), np.float32)).tolist() == [[0.0]]


@given(
    st.none() | st.floats(5.0, 60.0),
    st.floats(10.0, 40.0),
    st.integers(0, 2**32 - 1),
    st.floats(0.5, 8.0),
)
def test_points_are_seen_by_the_cells_that_they_are_of(
    d_mm: float | None, r_mm: float, seed: int, step: float
) -> None:
    geometry = Geometry(r_mm, d_mm, 50.0, DISC)
    random = np.random.default_rng(seed)
    grid = Grid(9, 11, *(random.uniform(60.0, 120.0, 2).tolist()), step)
    height_mm = random.uniform(0, r_mm / 2, (9, 11)).astype(np.float32)
    chosen = random.random((9, 11)) < 0.3
    points = skin_points(height_mm, disc_rays(grid, geometry), geometry)[chosen]
    labels = np.arange(1, len(points) + 1, dtype=np.uint16)
    expected = np.zeros((9, 11), np.uint16)
    expected[chosen] = labels
    np.testing.assert_array_equal(labels_by_cell(points, labels, grid, geometry), expected)


@given(st.none() | st.floats(5.0, 60.0), st.lists(st.tuples(*[st.floats(width=32)] * 3)))
def test_no_point_breaks_it(d_mm: float | None, points: list[tuple[float, float, float]]) -> None:
    given_mm = np.array(points, np.float32).reshape(-1, 3)
    labels = np.ones(len(given_mm), np.uint16)
    grid = Grid(5, 5, 1.0, 1.0, 4.0)
    seen = labels_by_cell(given_mm, labels, grid, Geometry(20.0, d_mm, 50.0, DISC))
    assert seen.shape == (5, 5)


CAMERAS = [None, 4.0, 14.0, 60.0]


@given(
    st.integers(1, 50), st.integers(1, 50), st.floats(-60, 90), st.floats(-60, 90), st.floats(0, 60)
)
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


@given(
    st.integers(0, 30),
    st.integers(0, 30),
    st.integers(1, 50),
    st.integers(1, 50),
    st.integers(1, 8),
)
def test_a_grid_lies_in_its_window_and_covers_it(
    row0: int, col0: int, rows: int, cols: int, step: int
) -> None:
    grid = Grid.of_window(Window(row0, col0, rows, cols), step)
    for first, count, begin, size in (
        (grid.row0, grid.rows, row0, rows),
        (grid.col0, grid.cols, col0, cols),
    ):
        last = first + step * (count - 1)
        assert begin <= first <= last < begin + size
        assert max(first - begin, begin + size - 1 - last) < step
        if size >= step:  # whatever the window, the same pixels of the image
            assert first % step == step // 2


def test_cells_beyond_the_image_are_not_in_it() -> None:
    seen = cells_in_image(
        Grid(4, 5, -1.6, -0.4, 1.3), 3, 5
    )  # rows -1.6, -0.3, 1.0, 2.3; columns -0.4 ... 4.8
    np.testing.assert_array_equal(seen.any(axis=1), [False, True, True, True])
    np.testing.assert_array_equal(seen.any(axis=0), [True, True, True, True, False])


def test_the_mask_holds_the_pixels_whose_centre_is_in_the_circle() -> None:
    mask = disc_mask(7, 9, Disc(3.0, 4.0, 2.0))
    expected = np.array([[(r - 3) ** 2 + (c - 4) ** 2 <= 4 for c in range(9)] for r in range(7)])
    np.testing.assert_array_equal(mask, expected)
    assert not disc_mask(7, 9, Disc(100.0, 100.0, 2.0)).any()


def test_the_rim_is_at_one_and_the_centre_at_zero() -> None:
    rho2 = radius_squared(Grid(11, 11, 0.0, 0.0, 1.0), Disc(5.0, 5.0, 5.0))
    assert (rho2[5, 5], rho2[5, 10], rho2[0, 5]) == (0, 1, 1)


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
    np.testing.assert_array_equal(
        rays.inside.ravel(), np.hypot(rows - 118.3, cols - 163.6) <= 102.4
    )


MAPPED = Disc(row_c=61.3, col_c=83.9, radius_px=47.7)


@pytest.mark.parametrize("distance", [None, 14.0])
def test_what_is_known_agrees_with_the_camera(distance: float | None) -> None:
    geometry = Geometry(20.0, distance, 50.0, MAPPED)
    known = disc_map.geometry_maps(geometry, 6.0)
    x, y, gain_x, _, cosine, pitch = known
    grid = disc_map.map_grid(MAPPED)
    rays = disc_rays(grid, geometry)
    row, col = 40, 75
    assert rays.inside[row, col]
    points = skin_points(np.zeros(rays.inside.shape, dtype=np.float32), rays, geometry)
    point = points[row, col].astype(float)
    camera = np.array((0.0, 0.0, -(distance or 1e9)))
    ray = (point - camera) / np.linalg.norm(point - camera)
    assert cosine[row, col] == pytest.approx(ray @ point / 20.0, abs=2e-3)
    assert x[row, col] == pytest.approx(
        (grid.col0 + grid.step_px * col - MAPPED.col_c) / MAPPED.radius_px, abs=1e-6
    )
    assert y[row, col] == pytest.approx(
        (grid.row0 + grid.step_px * row - MAPPED.row_c) / MAPPED.radius_px, abs=1e-6
    )
    assert pitch[0, 0] == pytest.approx(60 / MAPPED.radius_px)
    moved = point - (0, 0, 0.01)
    if distance is None:
        assert gain_x[row, col] == 0
    else:
        shift_px = geometry.f_px * (
            moved[0] / (moved[2] + distance) - point[0] / (point[2] + distance)
        )
        unit_mm = 20 * np.sin(np.radians(50))
        assert gain_x[row, col] == pytest.approx(
            shift_px / MAPPED.radius_px / 0.01 * unit_mm, rel=5e-3
        )


SHAPE = (480, 640)


def test_of_a_circle_that_the_image_cuts_the_part_inside_counts() -> None:
    assert rim_seen(SHAPE, Disc(240, 320, 200)) == 1
    assert rim_seen(SHAPE, Disc(-0.0, 320, 200)) == pytest.approx(0.5, abs=0.01)
    assert rim_seen(SHAPE, Disc(-300, 320, 200)) == 0
