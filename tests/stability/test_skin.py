"""Eq. 2 where it is ill-conditioned: h near r and over, rays that graze the skin, a lens on it or a metre away."""

from __future__ import annotations

from itertools import product

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.back_projection import cell_area_mm2, skin_points
from tacshade_edge.core.geometry.disc import DiscRays, disc_rays
from tacshade_edge.types import F32, Disc, Geometry

Precise = npt.NDArray[np.longdouble]

DISC = Disc(239.5, 319.5, 200.0)
DISTANCES_MM = (None, 1e-300, 0.1, 14.0, 100.0, 1000.0)
# Of the square under eq. 2's root, in skin radii squared.
SQUARE_BOUND = 2e-6


def geometry_of(skin_radius_mm: float, camera_distance_mm: float | None, half_angle_deg: float) -> Geometry:
    return Geometry(skin_radius_mm, camera_distance_mm, half_angle_deg, DISC)


def precise_points(height: F32, rays: DiscRays, geometry: Geometry) -> tuple[Precise, Precise]:
    """Eq. 2 in long double, and the square under its root."""
    u, v = rays.u.astype(np.longdouble), rays.v.astype(np.longdouble)
    rho = np.longdouble(np.float32(geometry.skin_radius_mm)) - height.astype(np.longdouble)
    if geometry.camera_distance_mm is None:
        square = rho * rho - (u * u + v * v)
        return np.stack((u, v, np.sqrt(np.maximum(square, 0))), axis=-1), square
    d = np.longdouble(np.float32(geometry.camera_distance_mm))
    k = 1 + u * u + v * v
    square = d * d - k * (d * d - rho * rho)
    s = (d + np.sqrt(np.maximum(square, 0))) / k
    return np.stack((s * u, s * v, s - d), axis=-1), square


@pytest.mark.slow
@pytest.mark.parametrize("distance_mm", DISTANCES_MM)
def test_points_are_those_of_more_digits(distance_mm: float | None) -> None:
    noise = np.random.default_rng(1).random((disc_map.CELLS, disc_map.CELLS))
    worst = 0.0
    for radius_mm, half_angle_deg, part in product(
        (1.0, 20.0, 200.0), (5.0, 50.0, 85.0), (0.0, 0.3, 0.999999, 1.0, noise)
    ):
        geometry = geometry_of(radius_mm, distance_mm, half_angle_deg)
        rays = disc_rays(disc_map.map_grid(DISC), geometry)
        inside = rays.inside
        height = (radius_mm * part * np.ones_like(noise)).astype(np.float32)
        points = skin_points(height, rays, geometry)
        assert np.isfinite(points).all()
        assert (np.linalg.norm(points.astype(np.float64), axis=-1)[inside] <= radius_mm * (1 + 1e-6)).all()
        expected, square = precise_points(height, rays, geometry)
        # A ray that grazes the deformed skin meets it anywhere along the root of the square's last digits.
        root = np.sqrt(np.maximum(square, 0)) / radius_mm
        bound = np.minimum(SQUARE_BOUND / np.maximum(root, 1e-9) + 5e-7, np.sqrt(SQUARE_BOUND))
        error = np.linalg.norm(points - expected, axis=-1) / radius_mm
        assert (error <= bound)[inside].all()
        worst = max(worst, float(error[inside & (root > 0.05)].max(initial=0)))
        area = cell_area_mm2(np.where(inside, np.moveaxis(points, -1, 0), np.float32(np.nan)))
        assert np.isfinite(area).all()
        assert (area >= 0).all()
    print(f"figure: eq. 2, lens {distance_mm} mm away: a point not grazed at most {worst:.0e} skin radii off")


@pytest.mark.slow
@given(
    radius_mm=st.floats(1, 200),
    distance_mm=st.none() | st.floats(0, 1000, exclude_min=True),
    half_angle_deg=st.floats(5, 85),
    over=st.floats(0, 1),
)
def test_a_height_of_the_radius_is_the_rays_point_nearest_to_the_centre(
    radius_mm: float, distance_mm: float | None, half_angle_deg: float, over: float
) -> None:
    geometry = geometry_of(radius_mm, distance_mm, half_angle_deg)
    part = (slice(40, 44), slice(50, 60))
    rays = disc_rays(disc_map.map_grid(DISC), geometry).part(part)
    points = skin_points(np.full((4, 10), radius_mm, np.float32), rays, geometry)
    assert np.isfinite(points).all()
    # Where the lens lies on the sphere's centre or near, its rays pass through it.
    nearest = np.linalg.norm(points, axis=-1)
    assert (nearest <= radius_mm * (1 + 1e-6)).all()
    shallower = skin_points(np.full((4, 10), radius_mm * over * 0.5, np.float32), rays, geometry)
    assert (np.linalg.norm(shallower, axis=-1) >= nearest - 1e-5 * radius_mm).all()
