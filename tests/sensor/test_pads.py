"""A pad is the limit of domes of growing radius with the same visible circle and the same lens."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.flat_skins import DISC, dome_like, pad
from tacshade_edge.lab.simulator.render import project
from tacshade_edge.sensor.depth.learned import (
    FLAT_DEG,
    LEARNT_DEG,
    as_learnt,
    scale_mm,
    shown_ratio,
)
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import (
    Grid,
    cell_area_mm2,
    disc_rays,
    labels_by_cell,
    point_heights,
    skin_planes,
    skin_points,
)
from tacshade_edge.sensor.geometry.disc_map import with_finite_radius
from tacshade_edge.sensor.recognition.naming import describe_touch
from tacshade_edge.types import F32, F64, Geometry, HeightMap

GRID = disc_map.map_grid(DISC, 28)
LENSES = st.none() | st.floats(10.0, 80.0)
RADII = st.floats(3.0, 40.0)
FLAT_MM = st.floats(200.0, 1e4)
"""Radii of domes that are nearly flat."""


def sag_mm(flat: Geometry, r_mm: float) -> float:
    """How far the dome rises over its visible circle, and float32's rounding of r."""
    half = math.asin(flat.visible_radius_mm / r_mm)
    return r_mm * (1 - math.cos(half)) + 4 * r_mm * float(np.finfo(np.float32).eps)


def heights(seed: int, most_mm: float) -> F32:
    shape = (GRID.rows, GRID.cols)
    return np.random.default_rng(seed).uniform(0, most_mm, shape).astype(np.float32)


@given(LENSES, RADII, st.floats(0.0, 0.9), st.tuples(*[st.floats(-1.0, 1.0)] * 2))
def test_a_seen_point_of_a_pad_comes_back(
    lens_mm: float | None, radius_mm: float, part: float, at: tuple[float, float]
) -> None:
    flat = pad(lens_mm, radius_mm)
    h_mm = part * flat.height_max_mm
    point = np.array((*(radius_mm * each for each in at), -h_mm))
    col, row = project(flat, point)
    rays = disc_rays(Grid(1, 1, float(row), float(col), 1.0), flat)
    found = skin_points(np.full((1, 1), h_mm, np.float32), rays, flat)
    np.testing.assert_allclose(found[0, 0], point, atol=1e-4)
    assert point_heights(point[None], flat)[0] == h_mm


@given(LENSES, RADII, FLAT_MM, st.integers(0, 2**32 - 1))
def test_flatter_and_flatter_domes_become_a_pad(
    lens_mm: float | None, radius_mm: float, r_mm: float, seed: int
) -> None:
    """Points, heights, areas and what the networks are given,
    at radii up to those that SENSOR.yaml accepts.
    """
    flat = pad(lens_mm, radius_mm)
    r_mm = max(r_mm, 10 * radius_mm)
    dome = dome_like(flat, r_mm)
    h_mm = heights(seed, 0.3 * min(radius_mm, flat.height_max_mm))
    (rays, points), (_, expected) = (
        (rays, skin_points(h_mm, rays, each).astype(np.float64))
        for each in (dome, flat)
        for rays in (disc_rays(GRID, each),)
    )
    foot_mm = r_mm * math.cos(math.radians(dome.visible_half_angle_deg))
    off = (points - (0, 0, foot_mm) - expected)[rays.inside]
    steep = 1 if lens_mm is None else 1 + radius_mm / (0.7 * lens_mm)
    most_mm = sag_mm(flat, r_mm)
    most_mm += 0.3 * radius_mm * radius_mm / r_mm  # h is along the radius
    assert np.abs(off).max() <= 2 * steep * most_mm
    np.testing.assert_allclose(
        point_heights(points[rays.inside], dome), h_mm[rays.inside], atol=most_mm
    )
    assert dome.mm_per_px == pytest.approx(flat.mm_per_px)
    assert dome.f_px == pytest.approx(flat.f_px)
    assert dome.size_mm == pytest.approx(flat.size_mm)
    assert scale_mm(dome) == pytest.approx(scale_mm(flat))


@given(LENSES, RADII, st.floats(2000.0, 1e4))
def test_the_networks_are_told_of_a_pad_what_flat_domes_tend_to(
    lens_mm: float | None, radius_mm: float, r_mm: float
) -> None:
    flat = pad(lens_mm, radius_mm)
    found, expected = (
        disc_map.geometry_maps(each, 4.0, 28) for each in (dome_like(flat, r_mm), flat)
    )
    steep = 1 if lens_mm is None else 1 + radius_mm / lens_mm
    np.testing.assert_allclose(found, expected, atol=3 * steep**2 * radius_mm / r_mm)


@given(LENSES, RADII, st.floats(0.1, 24.9))
def test_of_flat_skins_the_networks_are_told_the_flattest_dome_that_they_know(
    lens_mm: float | None, radius_mm: float, half_angle_deg: float
) -> None:
    flat = pad(lens_mm, radius_mm)
    dome = dome_like(flat, radius_mm / math.sin(math.radians(half_angle_deg)))
    for each in (flat, dome):
        known = as_learnt(each)
        assert known.visible_half_angle_deg == LEARNT_DEG
        assert known.visible_radius_mm == pytest.approx(radius_mm)
        assert known.f_px == pytest.approx(each.f_px)
        assert 1.5 <= shown_ratio(each) <= 1.9
        assert np.isfinite(disc_map.geometry_maps(known, 4.0, 28)).all()
    assert shown_ratio(flat) <= shown_ratio(dome)


@given(st.floats(FLAT_DEG, 85.0), LENSES)
def test_of_other_domes_the_networks_are_told_what_is_known(
    half_angle_deg: float, lens_mm: float | None
) -> None:
    dome = Geometry(20.0, lens_mm, half_angle_deg, DISC)
    assert as_learnt(dome) is dome
    assert shown_ratio(dome) == 1


def test_a_pad_at_rest_is_a_flat_disc() -> None:
    for lens_mm in (None, 27.0):
        flat = pad(lens_mm)
        rays = disc_rays(Grid(130, 170, 0.0, 0.0, 1.0), flat)
        planes = skin_planes(np.zeros(rays.inside.shape, np.float32), rays, flat)
        assert not planes[2].any()
        np.testing.assert_allclose(cell_area_mm2(planes)[1:-1, 1:-1], flat.mm_per_px**2, rtol=1e-3)
        assert np.hypot(*planes[:2])[rays.inside].max() == pytest.approx(15.0, rel=0.02)


def test_a_height_beyond_the_lens_is_guarded_and_nan_stays() -> None:
    h_mm = np.array([[0.0, 26.9, 40.0, np.nan]], np.float32)
    for lens_mm in (None, 27.0):
        flat = pad(lens_mm)
        x, y, z = skin_planes(h_mm, disc_rays(Grid(1, 4, 61.0, 70.0, 9.0), flat), flat)
        assert np.isfinite(np.stack((x, y, z))[:, :, :3]).all()
        assert np.isnan(np.stack((x, y, z))[:, :, 3]).all()
        assert lens_mm is None or x[0, 2] == 0


@given(LENSES, st.integers(0, 2**32 - 1))
def test_points_of_a_pad_are_seen_by_their_cells(lens_mm: float | None, seed: int) -> None:
    flat = pad(lens_mm)
    random = np.random.default_rng(seed)
    grid = Grid(9, 11, *(random.uniform(30.0, 60.0, 2).tolist()), 3.0)
    h_mm = random.uniform(0, 6.0, (9, 11)).astype(np.float32)
    chosen = random.random((9, 11)) < 0.3
    points = skin_points(h_mm, disc_rays(grid, flat), flat)[chosen]
    labels = np.arange(1, len(points) + 1, dtype=np.uint16)
    expected = np.zeros((9, 11), np.uint16)
    expected[chosen] = labels
    np.testing.assert_array_equal(labels_by_cell(points, labels, grid, flat), expected)


def test_sizes_of_usual_domes_are_their_radii() -> None:
    for half_angle_deg in (42.0, 50.0, 62.0):
        dome = Geometry(21.0359, 14.0, half_angle_deg, DISC)
        assert (dome.size_mm, dome.apex_z_mm, dome.height_max_mm) == (21.0359,) * 3
    flat = pad(27.0)
    assert (flat.apex_z_mm, flat.height_max_mm, flat.visible_radius_mm) == (0, 27.0, 15.0)
    assert flat.size_mm == pytest.approx(15 / math.sin(math.radians(40)))
    assert pad(None).height_max_mm == pad(None).size_mm


def test_planes_of_a_pad_have_one_type() -> None:
    flat = pad(27.0)
    rays = disc_rays(GRID, flat)
    planes: F64 = skin_planes(heights(1, 2.0), rays, flat)
    assert planes.dtype == np.float32


def test_a_touch_of_a_pad_has_a_finite_description() -> None:
    flat = with_finite_radius(pad(27.0))
    assert (flat.skin, flat.skin_radius_mm) == ("pad", flat.size_mm)
    grid = disc_map.map_grid(DISC, 112)
    rays = disc_rays(grid, flat)
    x, y = skin_points(np.zeros(rays.inside.shape, np.float32), rays, flat)[..., :2].T
    h_mm = np.maximum(2.0 - (x.T**2 + y.T**2) / 12, 0).astype(np.float32)
    height = HeightMap(h_mm, h_mm > 0.2, grid.row0, grid.col0, grid.step_px)
    description = describe_touch(height, rays, flat)
    assert description is not None
    assert np.isfinite(description).all()
    dome = Geometry(20.0, 14.0, 50.0, DISC)
    assert with_finite_radius(dome) is dome
