"""Heights that no solver should give, split, described and put on rays that graze the skin;
fits of odd presses.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from support.examples import examples
from support.networks import ALL_TRUSTED
from tacshade_edge.calibration import refit
from tacshade_edge.calibration.indenters import Ball
from tacshade_edge.lab.studies.evaluate.score import score_cloud
from tacshade_edge.sensor.depth.learned import Inverse
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import DiscRays, cell_area_mm2, disc_rays, skin_points
from tacshade_edge.sensor.geometry.disc_map import CELLS
from tacshade_edge.types import F32, Disc, Geometry

clouds = arrays(
    np.float32, st.tuples(st.integers(1, 20), st.just(3)), elements=st.floats(-1e6, 1e6, width=32)
)
BALL = Ball(0.0, 0.0, 23.0, 5.0)


@pytest.mark.slow
@given(found=clouds, true=clouds, h_max_mm=st.floats(1e-3, 200))
@examples(200)
def test_any_clouds_have_finite_scores(found: F32, true: F32, h_max_mm: float) -> None:
    score = score_cloud(found, true, h_max_mm)
    assert all(map(math.isfinite, (score.me_mm, score.sd, score.sd_sum, score.backward_mm)))
    assert score.me_mm >= 0
    assert score.sd_sum <= score.sd <= 1
    # float32 points in float64 distances.
    direct = np.linalg.norm(
        found[:, None].astype(np.float64) - true[None].astype(np.float64), axis=-1
    )
    assert score.me_mm == pytest.approx(direct.min(axis=1).mean(), rel=1e-9, abs=1e-9)


def inverse_of(height_mm: float, bad: float | None = None) -> Inverse:
    height = np.full((CELLS, CELLS), height_mm, np.float32)
    if bad is not None:
        height[50:60, 50:60] = bad
    return Inverse(height, np.full((CELLS, CELLS), 5, np.float32), ALL_TRUSTED)


@pytest.mark.parametrize("distance_mm", [None, 1e-6, 14.0, 1000.0])
@pytest.mark.parametrize("height_mm", [-1.0, 0.0, 1e-6, 1.0, 20.0, 1e6, 1e30])
@pytest.mark.parametrize("bad", [None, math.nan, math.inf, -math.inf])
def test_a_factor_is_in_its_range_whatever_the_network_said(
    distance_mm: float | None, height_mm: float, bad: float | None
) -> None:
    geometry = Geometry(20.0, distance_mm, 50.0, Disc(60.0, 60.0, 50.0))
    shown = refit.press_factor(inverse_of(height_mm, bad), geometry, BALL)
    if shown is None:
        return
    factor = refit.fit_factor([shown] * refit.LEAST_PRESSES)
    assert factor is not None
    assert refit.FACTOR_RANGE[0] <= factor <= refit.FACTOR_RANGE[1]


Precise = npt.NDArray[np.longdouble]

DISC = Disc(239.5, 319.5, 200.0)
DISTANCES_MM = (None, 1e-300, 0.1, 14.0, 100.0, 1000.0)
# Of the square under eq. 2's root, in skin radii squared.
SQUARE_BOUND = 2e-6


def geometry_of(
    skin_radius_mm: float, camera_distance_mm: float | None, half_angle_deg: float
) -> Geometry:
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
        assert (
            np.linalg.norm(points.astype(np.float64), axis=-1)[inside] <= radius_mm * (1 + 1e-6)
        ).all()
        expected, square = precise_points(height, rays, geometry)
        # A ray that grazes the deformed skin meets it anywhere along the root
        # of the square's last digits.
        root = np.sqrt(np.maximum(square, 0)) / radius_mm
        bound = np.minimum(SQUARE_BOUND / np.maximum(root, 1e-9) + 5e-7, np.sqrt(SQUARE_BOUND))
        error = np.linalg.norm(points - expected, axis=-1) / radius_mm
        assert (error <= bound)[inside].all()
        worst = max(worst, float(error[inside & (root > 0.05)].max(initial=0)))
        area = cell_area_mm2(np.where(inside, np.moveaxis(points, -1, 0), np.float32(np.nan)))
        assert np.isfinite(area).all()
        assert (area >= 0).all()
    print(
        f"figure: eq. 2, lens {distance_mm} mm away: "
        f"a point not grazed at most {worst:.0e} skin radii off"
    )


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
