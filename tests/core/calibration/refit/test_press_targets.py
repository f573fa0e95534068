from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.calibrated_sensor import HALF, calibrated, presses, simulated

from tacshade_edge.core.calibration.indenters.indenter import box, cylinder
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.refit.press_targets import (
    VIEWS,
    Targets,
    held_out,
    known_errors_mm,
    press_targets,
    seen_as,
)
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import load_network

FAST = load_network("fast")


@cache
def targets() -> Targets:
    return press_targets(calibrated(), PROFILES["fast"], FAST, presses())


def test_a_fifth_is_held_out_of_every_indenter_and_depth() -> None:
    image = np.zeros((2, 2), np.uint8)
    kinds = [(0.0, cylinder("flat", 3.0)), (0.0, box("square", 6, 6)), (3.0, None), (6.0, None)]
    table = [
        KnownPress(f"{k}", image, radius, 0.5 + 0.4 * (k // 4), 0.0, 0.0, indenter)
        for k in range(40)
        for radius, indenter in [kinds[k % 4]]
    ]
    train, judge = held_out(table)
    assert sorted(press.name for press in (*train, *judge)) == sorted(press.name for press in table)
    assert Counter((press.radius_mm, press.indenter) for press in judge) == dict.fromkeys(kinds, 2)
    depths = [press.depth_mm for press in judge]
    assert min(depths) < 1.5
    assert max(depths) > 3.0
    assert held_out(list(reversed(table))) == (train, judge)


def test_h_is_known_where_the_indenter_is_inside_the_skin_and_contact_is_seen() -> None:
    assert len(targets().presses) >= 18
    for press in targets().presses:
        assert (press.surface[press.known] > 0).all()
        assert (press.contact_logit[press.known] > 0).all()
        assert not (press.far & press.known).any()
        assert not (press.far & (press.surface > 0)).any()
        assert press.inside[press.far].all()
        assert press.surface.dtype == press.height.dtype == np.float32


def test_the_surface_is_the_skin_where_it_touches() -> None:
    """Of the shallowest and the deepest press, whose true skin the simulator knows."""
    geometry = calibrated().geometry
    for press in (min(presses(), key=lambda p: p.depth_mm), max(presses(), key=lambda p: p.depth_mm)):
        target = next(each for each in targets().presses if each.name == press.name)
        found_mm = target.surface.max() * targets().unit_mm
        assert press.x_mm is not None
        assert press.y_mm is not None
        # A ball is deepest where it is nearest to the middle of the sphere, deeper than under (x, y).
        assert press.depth_mm <= found_mm + 0.05
        assert found_mm < press.depth_mm + 0.15 * geometry.skin_radius_mm


def test_the_error_is_that_of_the_network_times_its_factor() -> None:
    sensor = targets().sensors[0]
    plain, refitted = (
        np.mean(known_errors_mm(targets(), FAST, sensor, factor)) for factor in (0.5, calibrated().factors["fast"])
    )
    assert refitted < 0.4
    assert plain > 2 * refitted


def test_a_press_that_does_not_show_its_contact_tells_nothing() -> None:
    free = simulated(HALF).frame((), 77).image
    assert press_targets(calibrated(), PROFILES["fast"], FAST, [replace(presses()[0], image=free)]).presses == ()


def test_a_press_is_shown_dragged_with_the_indenter_where_it_went() -> None:
    """The shipped network knows drags: it is about as far off as on the same presses undragged."""
    shown = press_targets(calibrated(), PROFILES["fast"], FAST, presses()[:10], drags=2)
    errors = np.array(known_errors_mm(shown, FAST, shown.sensors[0], calibrated().factors["fast"]))
    dragged = np.array([press.dragged for press in shown.presses])
    still = targets().presses[: np.count_nonzero(~dragged)]
    for press, before in zip((p for p in shown.presses if not p.dragged), still, strict=True):
        np.testing.assert_array_equal(press.white, before.white)
    assert np.count_nonzero(dragged) >= 1.5 * np.count_nonzero(~dragged)
    assert errors[dragged].mean() < 2 * errors[~dragged].mean()
    again = press_targets(calibrated(), PROFILES["fast"], FAST, presses()[:10], drags=2)
    for one, other in zip(shown.presses, again.presses, strict=True):
        np.testing.assert_array_equal(one.white, other.white)
        np.testing.assert_array_equal(one.surface, other.surface)


def test_views_are_all_turns_of_the_square_and_its_mirror_image() -> None:
    map_ = np.arange(9, dtype=np.float32).reshape(3, 3)
    seen = [seen_as(map_, view) for view in VIEWS]
    np.testing.assert_array_equal(seen[0], map_)
    assert len({each.tobytes() for each in seen}) == len(VIEWS) == 8
    assert {float(each[1, 1]) for each in seen} == {4.0}


@pytest.mark.parametrize("view", range(1, 8))
def test_another_view_is_as_good_a_sensor(view: int) -> None:
    """A network that was trained on sensors of every turn finds the same depth in another view of a press."""
    errors = []
    for press in targets().presses[:6]:
        side = FAST.fold
        white = press.white  # (fold², N, N): unfolded, seen otherwise, folded again
        from tacshade_edge.core.depth.network_maps import fold, unfold

        turned = fold(seen_as(unfold(white, side)[0], VIEWS[view])[None], side)
        height = unfold(FAST.run(turned, targets().sensors[view]).depth_and_contact, side)[0]
        errors.append(abs(height.max() - press.height.max()) * targets().unit_mm)
    assert np.mean(errors) < 0.3
