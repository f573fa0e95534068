import numpy as np
import pytest
from support.toy_network import ALL_TRUSTED

from tacshade_edge.core.calibration.refit import gain
from tacshade_edge.core.depth.learned import Inverse
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.back_projection import skin_points
from tacshade_edge.core.geometry.disc import disc_rays
from tacshade_edge.types import Disc, Geometry

DISC = Disc(61.3, 83.9, 47.7)
PLACES = ((0.0, 0.0), (5.0, -2.0), (-4.0, 6.0), (2.0, 7.0), (-6.0, -5.0), (7.0, 1.0), (0.0, -8.0), (3.0, 3.0))
BALLS = [(x, y, 1.0 + 0.4 * k, 4.0 + 0.5 * k) for k, (x, y) in enumerate(PLACES)]


def geometry(distance: float | None = 14.0) -> Geometry:
    return Geometry(20.0, distance, 50.0, DISC)


def seen(ball: gain.Ball, factor: float = 1.0, where: Geometry | None = None) -> Inverse:
    """A network that is off by a factor, and right about a contact that is the middle of the ball's imprint."""
    height = np.nan_to_num(gain.ball_height(where or geometry(), ball))
    contact = height > 0.5 * ball.depth_max_mm(20.0)
    logit = np.where(contact, 5, -5).astype(np.float32)
    return Inverse((factor * np.maximum(height, 0)).astype(np.float32), logit, ALL_TRUSTED)


def rows(factor: float, where: Geometry | None = None) -> list[gain.PressRows]:
    balls = [gain.stated_ball(where or geometry(), *b) for b in BALLS]
    made = [gain.press_rows(seen(b, factor, where), where or geometry(), b) for b in balls]
    return [m for m in made if m is not None]


@pytest.mark.parametrize("distance", [None, 14.0])
def test_a_balls_surface_is_where_its_rays_end(distance: float | None) -> None:
    where = geometry(distance)
    ball = gain.stated_ball(where, 4.0, -3.0, 2.0, 5.0)
    height = gain.ball_height(where, ball)
    rays = disc_rays(disc_map.map_grid(DISC), where)
    points = skin_points(height, rays, where)
    hit = np.isfinite(height)
    assert 500 < np.count_nonzero(hit) < hit.size / 2
    off = np.linalg.norm(points[hit] - (ball.x_mm, ball.y_mm, ball.z_mm), axis=1) - 5.0
    assert np.abs(off).max() < 1e-3
    assert np.nanmax(height) == pytest.approx(ball.depth_max_mm(20.0), abs=0.02)


def test_the_stated_depth_is_along_z() -> None:
    ball = gain.stated_ball(geometry(), 6.0, 0.0, 2.0, 5.0)
    assert ball.z_mm - 5.0 == pytest.approx(np.sqrt(400 - 36) - 2.0)
    assert gain.stated_ball(geometry(), 0.0, 0.0, 2.0, 5.0).depth_max_mm(20.0) == pytest.approx(2.0)


@pytest.mark.parametrize(("x_mm", "y_mm"), [(0.0, 0.0), (5.0, -2.0), (-4.0, 6.0)])
def test_a_ball_is_located_by_its_contact(x_mm: float, y_mm: float) -> None:
    ball = gain.stated_ball(geometry(), x_mm, y_mm, 2.5, 6.0)
    found = gain.located_ball(geometry(), seen(ball), 2.5, 6.0)
    assert found is not None
    assert np.hypot(found.x_mm - x_mm, found.y_mm - y_mm) < 0.25
    assert found.z_mm == pytest.approx(ball.z_mm, abs=0.2)


def test_without_contact_there_is_nothing_to_locate_or_fit() -> None:
    nothing = Inverse(np.zeros((112, 112), dtype=np.float32), np.full((112, 112), -5, dtype=np.float32), ALL_TRUSTED)
    ball = gain.stated_ball(geometry(), 0.0, 0.0, 2.0, 5.0)
    assert gain.located_ball(geometry(), nothing, 2.0, 5.0) is None
    assert gain.press_rows(nothing, geometry(), ball) is None


@pytest.mark.parametrize(("factor", "left"), [(0.6, 0.05), (0.75, 0.05), (1.0, 0.01), (1.35, 0.05)])
def test_a_constant_factor_is_taken_away(factor: float, left: float) -> None:
    fitted = gain.fit_factor(rows(factor))
    assert fitted is not None
    ball = gain.stated_ball(geometry(), -2.0, 3.0, 2.2, 5.5)  # not one of the presses
    assert fitted * seen(ball, factor).height_mm.max() == pytest.approx(ball.depth_max_mm(20.0), rel=left)


def presses_that_tell(factors: list[float], cells: int = 20) -> list[gain.PressRows]:
    return [gain.PressRows(np.full(cells, cells**-0.5), np.full(cells, t * cells**-0.5)) for t in factors]


def test_every_press_counts_whatever_its_contacts_size() -> None:
    made = presses_that_tell([1.1] * 3) + presses_that_tell([1.0] * 3, cells=2000)
    assert gain.fit_factor(made) == pytest.approx(1.05, abs=0.01)


def test_wrong_presses_hardly_move_it() -> None:
    spread = list(1.2 * np.exp(np.random.default_rng(3).normal(0, 0.1, 35)))
    honest, misled = (gain.fit_factor(presses_that_tell(spread + wrong)) for wrong in ([], [3.0] * 5))
    assert honest == pytest.approx(1.2, abs=0.03)
    assert misled == pytest.approx(honest, rel=0.05)


def test_presses_that_do_not_agree_draw_it_less_far() -> None:
    """It stays nearer to 1 the fewer they are and the less they agree."""
    clear, spread = ([1.5 * f for f in np.exp(s * np.linspace(-1, 1, 6))] for s in (0.02, 0.6))
    few, many = (gain.fit_factor(presses_that_tell(spread * n)) or 0.0 for n in (1, 6))
    assert 1.1 < few < many < (gain.fit_factor(presses_that_tell(clear)) or 0.0)
    assert gain.fit_factor(presses_that_tell(clear)) == pytest.approx(1.5, abs=0.02)


def test_few_presses_fit_nothing() -> None:
    assert gain.fit_factor(rows(0.7)[: gain.LEAST_PRESSES - 1]) is None


def test_the_factor_is_bounded() -> None:
    low, high = gain.FACTOR_RANGE
    assert gain.fit_factor(rows(0.1)) == pytest.approx(high)
    assert gain.fit_factor(rows(20.0)) == pytest.approx(low)
