from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.geometry.back_projection import cell_area_mm2, cells_that_see, skin_planes, skin_points
from tacshade_edge.core.geometry.disc import DiscRays, Grid, disc_rays
from tacshade_edge.simulator.render import project
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
def test_a_seen_skin_point_comes_back(d_mm: float | None, r_mm: float, part: float, polar: float, turn: float) -> None:
    h_mm = part * r_mm
    theta = math.radians(polar)
    normal = np.array([math.sin(theta) * math.cos(turn), math.sin(theta) * math.sin(turn), math.cos(theta)])
    point = (r_mm - h_mm) * normal
    geometry = Geometry(r_mm, d_mm, 50.0, DISC)
    col, row = project(geometry, point)
    rays = disc_rays(Grid(1, 1, float(row), float(col), 1.0), geometry)
    found = skin_points(np.full((1, 1), h_mm, np.float32), rays, geometry)
    np.testing.assert_allclose(found[0, 0], point, atol=1e-3)


@pytest.mark.parametrize("d_mm", [None, 14.0])
def test_the_apex_is_at_the_radius_less_the_height(d_mm: float | None) -> None:
    found = skin_points(np.array([0, 3], np.float32), rays_of([0, 0], [0, 0]), Geometry(20.0, d_mm, 50.0, DISC))
    np.testing.assert_allclose(found, [[0, 0, 20], [0, 0, 17]], atol=1e-5)


@pytest.mark.parametrize("d_mm", [None, 14.0])
def test_a_height_out_of_the_rays_reach_is_guarded(d_mm: float | None) -> None:
    geometry = Geometry(20.0, d_mm, 50.0, DISC)
    slope = 15.0 if d_mm is None else 0.5
    heights = np.array([0, 18, 20], np.float32)
    found = skin_points(heights, rays_of([slope] * 3, [0] * 3), geometry)
    assert np.isfinite(found).all()
    if d_mm is not None:  # the foot of the perpendicular from O on the ray
        foot = d_mm * 0.5 / 1.25
        np.testing.assert_allclose(found[1], [foot, 0, foot / 0.5 - d_mm], atol=1e-4)
    assert np.linalg.norm(found[0]) == pytest.approx(20, abs=1e-4)


@pytest.mark.parametrize("d_mm", [None, 14.0])
def test_nan_stays_nan(d_mm: float | None) -> None:
    heights = np.array([np.nan, 1], np.float32)
    found = skin_points(heights, rays_of([0.1, 0.1], [0, 0]), Geometry(20.0, d_mm, 50.0, DISC))
    assert np.isnan(found[0]).all()
    assert np.isfinite(found[1]).all()


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
    np.testing.assert_array_equal(cell_area_mm2(np.moveaxis(points, -1, 0)), np.nan_to_num(expected))


def test_a_line_of_points_has_no_area() -> None:
    assert cell_area_mm2(np.zeros((3, 1, 5), np.float32)).tolist() == [[0.0] * 5]
    assert cell_area_mm2(np.zeros((3, 1, 1), np.float32)).tolist() == [[0.0]]


@given(st.none() | st.floats(5.0, 60.0), st.floats(10.0, 40.0), st.integers(0, 2**32 - 1), st.floats(0.5, 8.0))
def test_points_are_seen_by_the_cells_that_they_are_of(d_mm: float | None, r_mm: float, seed: int, step: float) -> None:
    geometry = Geometry(r_mm, d_mm, 50.0, DISC)
    random = np.random.default_rng(seed)
    grid = Grid(9, 11, *(random.uniform(60.0, 120.0, 2).tolist()), step)
    height_mm = random.uniform(0, r_mm / 2, (9, 11)).astype(np.float32)
    chosen = random.random((9, 11)) < 0.3
    points = skin_points(height_mm, disc_rays(grid, geometry), geometry)[chosen]
    np.testing.assert_array_equal(cells_that_see(points, grid, geometry), chosen)


@given(st.none() | st.floats(5.0, 60.0), st.lists(st.tuples(*[st.floats(width=32)] * 3)))
def test_no_point_breaks_it(d_mm: float | None, points: list[tuple[float, float, float]]) -> None:
    given_mm = np.array(points, np.float32).reshape(-1, 3)
    seen = cells_that_see(given_mm, Grid(5, 5, 1.0, 1.0, 4.0), Geometry(20.0, d_mm, 50.0, DISC))
    assert seen.shape == (5, 5)
