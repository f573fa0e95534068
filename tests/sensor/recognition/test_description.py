from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.calibration.indenters import Indenter, box, cylinder, place
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import disc_rays
from tacshade_edge.sensor.recognition.description import LEAST_CELLS, describe
from tacshade_edge.types import F32, Bool, Disc, Geometry

PINHOLE = Geometry(20.0, 14.0, 50.0, Disc(239.5, 319.5, 200.0))
ORTHOGRAPHIC = Geometry(20.0, None, 50.0, Disc(239.5, 319.5, 200.0))
SQUARE, ROUND = box("square", 7.0, 7.0), cylinder("round", 4.0)


def touch(
    indenter: Indenter, yaw_deg: float = 0.0, x_mm: float = 0.0, geometry: Geometry = PINHOLE
) -> tuple[F32, Bool]:
    """Heights and contact of an indenter's own surface, without any skin around it."""
    placed = place(indenter, geometry.skin_radius_mm, x_mm, 0.5, 2.5, yaw_deg)
    found = placed.height_mm(disc_rays(disc_map.map_grid(geometry.disc), geometry), geometry)
    return np.nan_to_num(found), found > 0


def described(*args: float | Indenter, geometry: Geometry = PINHOLE) -> F32:
    height, contact = touch(*args, geometry=geometry)  # type: ignore[arg-type]
    rays = disc_rays(disc_map.map_grid(geometry.disc), geometry)
    found = describe(height, contact, rays, geometry)
    assert found is not None
    return found


def apart(one: F32, other: F32) -> float:
    return float(np.linalg.norm(one - other))


@pytest.mark.parametrize("geometry", [PINHOLE, ORTHOGRAPHIC], ids=["pinhole", "orthographic"])
def test_a_turn_changes_less_than_another_form(geometry: Geometry) -> None:
    square = described(SQUARE, geometry=geometry)
    other = apart(square, described(ROUND, geometry=geometry))
    for yaw_deg in (20.0, 45.0, 170.0):
        assert apart(square, described(SQUARE, yaw_deg, geometry=geometry)) < 0.6 * other


def test_another_place_changes_less_than_another_form() -> None:
    square = described(SQUARE)
    assert apart(square, described(SQUARE, 10.0, 2.0)) < apart(square, described(ROUND))


def test_too_few_cells_have_no_form() -> None:
    rays = disc_rays(disc_map.map_grid(PINHOLE.disc), PINHOLE)
    height = np.where(rays.inside, np.float32(1), np.float32(np.nan))
    touched = np.zeros(height.shape, bool)
    touched[50, 50 : 50 + LEAST_CELLS - 1] = True
    assert describe(height, touched, rays, PINHOLE) is None
    touched[50, 50 + LEAST_CELLS - 1] = True
    assert describe(height, touched, rays, PINHOLE) is not None


@given(st.integers(0, 2**32 - 1), st.floats(0.001, 1), st.floats(0, 20), st.booleans())
def test_any_map_has_finite_numbers(seed: int, part: float, deepest: float, pinhole: bool) -> None:
    geometry = PINHOLE if pinhole else ORTHOGRAPHIC
    rays = disc_rays(disc_map.map_grid(geometry.disc, 56), geometry)
    random = np.random.default_rng(seed)
    height = random.uniform(0, deepest, rays.inside.shape).astype(np.float32)
    height[~rays.inside] = np.nan
    touched = rays.inside & (random.random(height.shape) < part)
    found = describe(height, touched, rays, geometry)
    if found is None:
        assert np.count_nonzero(touched) < LEAST_CELLS
    else:
        assert found.dtype == np.float32
        assert found.shape == described(SQUARE).shape
        assert np.isfinite(found).all()
