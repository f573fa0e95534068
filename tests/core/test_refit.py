from itertools import pairwise

import numpy as np
import pytest

from tacshade_edge.core import discmap, refit
from tacshade_edge.core.disc import disc_rays
from tacshade_edge.core.skin import skin_points
from tacshade_edge.core.solvers.learned import Inverse
from tacshade_edge.types import F32, Disc, Geometry

DISC = Disc(61.3, 83.9, 47.7)
PLACES = ((0.0, 0.0), (5.0, -2.0), (-4.0, 6.0), (2.0, 7.0), (-6.0, -5.0), (7.0, 1.0), (0.0, -8.0), (3.0, 3.0))
BALLS = [(x, y, 1.0 + 0.4 * k, 4.0 + 0.5 * k) for k, (x, y) in enumerate(PLACES)]


def geometry(distance: float | None = 14.0) -> Geometry:
    return Geometry(20.0, distance, 50.0, DISC)


def seen(ball: refit.Ball, factor: float = 1.0, where: Geometry | None = None) -> Inverse:
    """A network that is off by a factor, and right about a contact that is the middle of the ball's imprint."""
    height = np.nan_to_num(refit.ball_height(where or geometry(), ball))
    contact = height > 0.5 * ball.depth_max_mm(20.0)
    return Inverse((factor * np.maximum(height, 0)).astype(np.float32), np.where(contact, 5, -5).astype(np.float32))


def rows(factor: float, where: Geometry | None = None) -> list[refit.PressRows]:
    known = discmap.geometry_maps(where or geometry(), 6.0)
    balls = [refit.stated_ball(where or geometry(), *b) for b in BALLS]
    made = [refit.press_rows(seen(b, factor, where), known, where or geometry(), b) for b in balls]
    return [m for m in made if m is not None]


@pytest.mark.parametrize("distance", [None, 14.0])
def test_a_balls_surface_is_where_its_rays_end(distance: float | None) -> None:
    where = geometry(distance)
    ball = refit.stated_ball(where, 4.0, -3.0, 2.0, 5.0)
    height = refit.ball_height(where, ball)
    rays = disc_rays(discmap.map_grid(DISC), where)
    points, _ = skin_points(height, rays, where)
    hit = np.isfinite(height)
    assert 500 < np.count_nonzero(hit) < hit.size / 2
    off = np.linalg.norm(points[hit] - (ball.x_mm, ball.y_mm, ball.z_mm), axis=1) - 5.0
    assert np.abs(off).max() < 1e-3
    assert np.nanmax(height) == pytest.approx(ball.depth_max_mm(20.0), abs=0.02)


def test_the_stated_depth_is_along_z() -> None:
    ball = refit.stated_ball(geometry(), 6.0, 0.0, 2.0, 5.0)
    assert ball.z_mm - 5.0 == pytest.approx(np.sqrt(400 - 36) - 2.0)
    assert refit.stated_ball(geometry(), 0.0, 0.0, 2.0, 5.0).depth_max_mm(20.0) == pytest.approx(2.0)


@pytest.mark.parametrize(("x_mm", "y_mm"), [(0.0, 0.0), (5.0, -2.0), (-4.0, 6.0)])
def test_a_ball_is_located_by_its_contact(x_mm: float, y_mm: float) -> None:
    ball = refit.stated_ball(geometry(), x_mm, y_mm, 2.5, 6.0)
    found = refit.located_ball(geometry(), seen(ball), 2.5, 6.0)
    assert found is not None
    assert np.hypot(found.x_mm - x_mm, found.y_mm - y_mm) < 0.25
    assert found.z_mm == pytest.approx(ball.z_mm, abs=0.2)


def test_without_contact_there_is_nothing_to_locate_or_fit() -> None:
    nothing = Inverse(np.zeros((112, 112), dtype=np.float32), np.full((112, 112), -5, dtype=np.float32))
    ball = refit.stated_ball(geometry(), 0.0, 0.0, 2.0, 5.0)
    assert refit.located_ball(geometry(), nothing, 2.0, 5.0) is None
    assert refit.press_rows(nothing, discmap.geometry_maps(geometry(), 6.0), geometry(), ball) is None


@pytest.mark.parametrize(("factor", "left"), [(0.6, 0.05), (0.75, 0.05), (1.0, 0.01), (1.35, 0.05)])
def test_a_constant_factor_is_taken_away(factor: float, left: float) -> None:
    weights = refit.fit_refit(rows(factor))
    assert weights.dtype == np.float32
    ball = refit.stated_ball(geometry(), -2.0, 3.0, 2.2, 5.5)  # not one of the presses
    known = discmap.geometry_maps(geometry(), 6.0)
    height = refit.apply_refit(weights, seen(ball, factor).height_mm, known)
    assert height.max() == pytest.approx(ball.depth_max_mm(20.0), rel=left)


def test_a_small_factor_is_left_because_other_shapes_have_another() -> None:
    weights = refit.fit_refit(rows(0.97))
    assert weights[0] == pytest.approx(1.0, abs=0.01)


def test_what_is_right_stays() -> None:
    weights = refit.fit_refit(rows(1.0))
    known = discmap.geometry_maps(geometry(), 6.0)
    height: F32 = np.linspace(0, 5, 112 * 112, dtype=np.float32).reshape(112, 112)
    np.testing.assert_allclose(refit.apply_refit(weights, height, known), height, rtol=0.03)


def test_few_presses_fit_nothing_and_no_weights_change_nothing() -> None:
    weights = refit.fit_refit(rows(0.7)[: refit.LEAST_PRESSES - 1])
    assert weights.size == 0
    height = np.ones((112, 112), dtype=np.float32)
    known = discmap.geometry_maps(geometry(), 6.0)
    assert refit.apply_refit(weights, height, known) is height


def test_the_factor_is_bounded() -> None:
    known = discmap.geometry_maps(geometry(), 6.0)
    height = np.ones((112, 112), dtype=np.float32)
    low, high = refit.FACTOR_RANGE
    wild = np.array((1e6, 0, 0, 0, 0, 0), dtype=np.float32)
    assert refit.apply_refit(wild, height, known).max() == pytest.approx(high)
    assert refit.apply_refit(-wild, height, known).min() == pytest.approx(low)


def test_more_depth_stays_more_depth() -> None:
    weights = refit.fit_refit(rows(0.8))
    known = discmap.geometry_maps(geometry(), 6.0)
    tops = []
    for depth in (1.0, 1.5, 2.0, 3.0, 4.0):
        ball = refit.stated_ball(geometry(), 1.0, 1.0, depth, 5.0)
        tops.append(refit.apply_refit(weights, seen(ball, 0.8).height_mm, known).max())
    assert all(b > a for a, b in pairwise(tops))
