from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.calibrated_sensor import HALF, calibrated, presses, references
from support.networks import ALL_TRUSTED
from tacshade_edge.calibration import refit
from tacshade_edge.calibration.indenters import Ball, known_height, stated_ball
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.refit import (
    Refit,
    error_scale,
    errors_in_sigma,
    placed_press,
    press_q,
    refit_profile,
)
from tacshade_edge.sensor.depth.learned import Inverse
from tacshade_edge.sensor.depth.sigma import INTERVAL_90, SigmaModel
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import disc_rays, skin_points
from tacshade_edge.sensor.inference.network import load_networks, make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import Disc, Frame, Geometry

DISC = Disc(61.3, 83.9, 47.7)
PLACES = (
    (0.0, 0.0),
    (5.0, -2.0),
    (-4.0, 6.0),
    (2.0, 7.0),
    (-6.0, -5.0),
    (7.0, 1.0),
    (0.0, -8.0),
    (3.0, 3.0),
)
BALLS = [(x, y, 1.0 + 0.4 * k, 4.0 + 0.5 * k) for k, (x, y) in enumerate(PLACES)]
FLAT = SigmaModel((0.0,) * 5, 3.0, 0.0, 1.0)
"""1 mm everywhere on a skin of 20 mm, and q is the scale."""


def geometry(distance: float | None = 14.0) -> Geometry:
    return Geometry(20.0, distance, 50.0, DISC)


def seen(ball: Ball, factor: float = 1.0) -> Inverse:
    """A network that is off by a factor, and right about a contact that is the middle
    of the ball's imprint.
    """
    height = np.nan_to_num(known_height(geometry(), ball))
    contact = height > 0.5 * ball.depth_max_mm(20.0)
    logit = np.where(contact, 5, -5).astype(np.float32)
    return Inverse((factor * np.maximum(height, 0)).astype(np.float32), logit, ALL_TRUSTED)


def rows(factor: float) -> list[tuple[float, float]]:
    balls = [stated_ball(20.0, *b) for b in BALLS]
    made = [refit.press_factor(seen(b, factor), geometry(), b) for b in balls]
    return [m for m in made if m is not None]


def unplaced(depth_mm: float, radius_mm: float) -> KnownPress:
    return KnownPress("", np.zeros((1, 1), np.uint8), radius_mm, depth_mm, None, None)


@pytest.mark.parametrize("distance", [None, 14.0])
def test_a_balls_surface_is_where_its_rays_end(distance: float | None) -> None:
    where = geometry(distance)
    ball = stated_ball(20.0, 4.0, -3.0, 2.0, 5.0)
    height = known_height(where, ball)
    rays = disc_rays(disc_map.map_grid(DISC), where)
    points = skin_points(height, rays, where)
    hit = np.isfinite(height)
    assert 500 < np.count_nonzero(hit) < hit.size / 2
    off = np.linalg.norm(points[hit] - (ball.x_mm, ball.y_mm, ball.z_mm), axis=1) - 5.0
    assert np.abs(off).max() < 1e-3
    assert np.nanmax(height) == pytest.approx(ball.depth_max_mm(20.0), abs=0.02)
    assert ball.z_mm - 5.0 == pytest.approx(np.sqrt(400 - 25) - 2.0), "the depth is along z"


@pytest.mark.parametrize(("x_mm", "y_mm"), [(0.0, 0.0), (-4.0, 6.0)])
def test_a_ball_is_located_by_its_contact(x_mm: float, y_mm: float) -> None:
    ball = stated_ball(20.0, x_mm, y_mm, 2.5, 6.0)
    found = placed_press(geometry(), seen(ball), unplaced(2.5, 6.0))
    assert isinstance(found, Ball)
    assert np.hypot(found.x_mm - x_mm, found.y_mm - y_mm) < 0.25
    assert found.z_mm == pytest.approx(ball.z_mm, abs=0.2)


def test_without_contact_there_is_nothing_to_locate_or_fit() -> None:
    nothing = Inverse(
        np.zeros((112, 112), dtype=np.float32),
        np.full((112, 112), -5, dtype=np.float32),
        ALL_TRUSTED,
    )
    assert placed_press(geometry(), nothing, unplaced(2.0, 5.0)) is None
    assert refit.press_factor(nothing, geometry(), stated_ball(20.0, 0.0, 0.0, 2.0, 5.0)) is None


@pytest.mark.parametrize(("factor", "left"), [(1.0, 0.01), (1.35, 0.05), (1.7, 0.05)])
def test_heights_too_great_by_a_factor_are_lowered(factor: float, left: float) -> None:
    fitted = refit.fit_factor(rows(factor))
    assert fitted is not None
    ball = stated_ball(20.0, -2.0, 3.0, 2.2, 5.5)  # not one of the presses
    assert fitted * seen(ball, factor).height_mm.max() == pytest.approx(
        ball.depth_max_mm(20.0), rel=left
    )


def presses_that_tell(factors: list[float]) -> list[tuple[float, float]]:
    return [(1.0, factor) for factor in factors]


def test_a_small_factor_is_the_shapes_and_a_large_one_the_sensors() -> None:
    assert refit.fit_factor(presses_that_tell([0.97] * 40)) == pytest.approx(1.0, abs=0.005)
    assert refit.fit_factor(presses_that_tell([0.67] * 40)) == pytest.approx(0.67, rel=0.02)


@pytest.mark.parametrize(("told", "factor"), [(1.1, 1.01), (1.3, 1.12), (1.5, 1.3), (2.0, 1.79)])
def test_presses_that_ask_for_greater_heights_are_believed_less(told: float, factor: float) -> None:
    assert refit.fit_factor(presses_that_tell([told] * 40)) == pytest.approx(factor, abs=0.01)


def test_wrong_presses_hardly_move_it() -> None:
    spread = list(0.8 * np.exp(np.random.default_rng(3).normal(0, 0.1, 35)))
    honest, misled = (
        refit.fit_factor(presses_that_tell(spread + wrong)) for wrong in ([], [0.3] * 5)
    )
    assert honest == pytest.approx(0.8, abs=0.05)
    assert misled == pytest.approx(honest, rel=0.05)


def test_presses_that_do_not_agree_draw_it_less_far() -> None:
    """It stays nearer to 1 the fewer they are and the less they agree."""
    clear, spread = ([0.67 * f for f in np.exp(s * np.linspace(-1, 1, 6))] for s in (0.02, 0.6))
    few, many = (refit.fit_factor(presses_that_tell(spread * n)) or 0.0 for n in (1, 6))
    assert 0.9 > few > many > (refit.fit_factor(presses_that_tell(clear)) or 0.0)
    assert refit.fit_factor(presses_that_tell(clear)) == pytest.approx(0.67, abs=0.03)


def test_few_presses_fit_nothing_and_the_factor_is_bounded() -> None:
    assert refit.fit_factor(rows(0.7)[: refit.LEAST_PRESSES - 1]) is None
    low, high = refit.FACTOR_RANGE
    assert refit.fit_factor(rows(0.1)) == pytest.approx(high)
    assert refit.fit_factor(rows(20.0)) == pytest.approx(low)


def test_presses_count_alike_however_large() -> None:
    large, small = np.full(1000, 1.0), np.full(10, 5.0)
    assert press_q([large] * 9 + [small]) == pytest.approx(1 / INTERVAL_90)
    assert press_q([large] * 8 + [small] * 2) == pytest.approx(5 / INTERVAL_90)
    assert press_q([np.zeros(4)]) > 0


def test_the_scale_follows_from_q_by_the_line_and_stays_in_its_range() -> None:
    errors = [np.full(10, 2 * INTERVAL_90)]
    assert error_scale(FLAT, errors) == pytest.approx(2.0)
    line = SigmaModel(FLAT.weights, 3.0, np.log(1.5), 0.5)
    assert error_scale(line, errors) == pytest.approx(1.5 * np.sqrt(2))
    assert error_scale(FLAT, [np.full(10, 1e9)]) == 20.0
    assert error_scale(FLAT, [np.zeros(10)]) == 0.2


def test_errors_are_those_of_the_known_cells() -> None:
    geometry = calibrated().geometry
    height = np.full((112, 112), 2.0, np.float32)
    true, known = height.copy(), np.zeros((112, 112), bool)
    known[50:52, 50] = True
    true[50, 50], true[51, 50] = 1.5, 3.0
    size_mm = HALF.skin_radius_mm / 20
    logits = np.zeros((112, 112), np.float32), np.full((28, 28), -9, np.float32)
    found = errors_in_sigma(FLAT, height, true, *logits, known, geometry)
    np.testing.assert_allclose(found, np.array([0.5, 1.0]) / size_mm, rtol=1e-6)


def refitted(table: list[KnownPress], profile: str = "fast") -> Refit:
    unloaded = calibrated(count=0)
    refit = refit_profile(unloaded, PROFILES[profile], load_networks()[profile], table)
    assert refit is not None
    return refit


@pytest.mark.slow
def test_the_error_is_that_on_presses_of_which_the_refit_knows_nothing() -> None:
    """A third of the presses against a refit to the rest, as its leave-one-out error says."""
    radius_mm, errors, promised = HALF.skin_radius_mm, [], []
    for part in range(3):
        refit = refitted([press for k, press in enumerate(presses()) if k % 3 != part])
        made = make_reconstructor(
            replace(calibrated(count=0), factors={"fast": refit.factor}), PROFILES["fast"]
        )
        promised.append(refit.fit.depth_mae_mm)
        for press in presses()[part::3]:
            found_mm = made.step(Frame(0, 0, 0, press.image)).depth_max_mm
            errors.append(abs(found_mm - press.placed(radius_mm).depth_max_mm(radius_mm)))
    assert 1 / 1.5 < np.mean(errors) / np.mean(promised) < 1.5


@pytest.mark.slow
def test_presses_without_a_place_refit_about_as_well() -> None:
    stated = refitted(list(presses()), "accurate").fit
    located = refitted(
        [replace(press, x_mm=None, y_mm=None) for press in presses()], "accurate"
    ).fit
    assert located.presses >= 18
    assert located.depth_mae_mm < stated.depth_mae_mm + 0.1


@pytest.mark.slow
def test_presses_without_contact_refit_nothing() -> None:
    unloaded = calibrated(count=0)
    free = [replace(press, image=references()[0]) for press in presses()]
    assert refit_profile(unloaded, PROFILES["fast"], load_networks()["fast"], free) is None
