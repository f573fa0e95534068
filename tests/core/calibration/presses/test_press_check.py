from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.calibrated_sensor import HALF, calibrated, presses, simulated, unloaded

from tacshade_edge.core.calibration.indenters import box
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.presses.press_check import PressCheck, PressView, PressViewer
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import load_networks
from tacshade_edge.simulator.press import Press, ridge
from tacshade_edge.types import Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))
PRESS = KnownPress("press", np.zeros((2, 2), np.uint8), 12.0, 2.0, 6.0, -3.0)
RIGHT = PressView(2.0, 6.0, -3.0, 1.1)


@cache
def viewer() -> PressViewer:
    return PressViewer(calibrated(count=0), PROFILES["accurate"], load_networks()["accurate"])


def seen(press: KnownPress) -> PressView:
    view = viewer().view(press)
    assert view is not None
    return view


@pytest.mark.slow
def test_balls_are_seen_where_they_are_and_as_large_as_they_are() -> None:
    for press in presses():
        view = seen(press)
        assert math.hypot(view.x_mm - (press.x_mm or 0), view.y_mm - (press.y_mm or 0)) < 0.8, press.name
        assert view.ball_factor > 0.8, press.name
        assert view.ball_factor < 1.5 or view.misfit_ratio < 4, press.name
        assert viewer().touches(press.image)


@pytest.mark.slow
@pytest.mark.parametrize(("stated", "low", "high"), [(2.0, 0.4, 0.62), (0.5, 1.6, 2.6)])
def test_a_ball_of_another_radius_is_seen(stated: float, low: float, high: float) -> None:
    deep = [press for press in presses() if press.depth_mm > 1]
    factors = [seen(replace(press, radius_mm=stated * press.radius_mm)).ball_factor for press in deep]
    assert low < float(np.median(factors)) < high


@pytest.mark.slow
def test_another_indenter_is_located_beside_its_stated_place() -> None:
    image = simulated(HALF).frame((Press(ridge(8.0, 6.0), 3.0, -2.0, 2.0),), 9).image
    stated = KnownPress("square", image, 0.0, 2.0, 3.0, -2.0, box("square", 8.0, 6.0))
    assert math.hypot(seen(stated).x_mm - 3.0, seen(stated).y_mm + 2.0) < 0.6
    moved = seen(replace(stated, x_mm=6.0))
    assert math.hypot(moved.x_mm - 3.0, moved.y_mm + 2.0) < 1.2
    assert math.isnan(moved.ball_factor)


@pytest.mark.slow
def test_the_free_skin_shows_no_press() -> None:
    assert viewer().view(replace(presses()[0], image=unloaded())) is None
    assert not viewer().touches(unloaded())


@pytest.mark.slow
def test_the_free_skin_is_no_press() -> None:
    assert not PressCheck(calibrated(count=0), load_networks()["accurate"]).judge(unloaded()).in_contact
