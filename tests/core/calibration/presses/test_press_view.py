from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.calibrated_sensor import HALF, calibrated, presses, simulated, unloaded

from tacshade_edge.core.calibration.indenters.indenter import box
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.presses.press_view import PressView, PressViewer
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import load_networks
from tacshade_edge.simulator.objects import ridge
from tacshade_edge.simulator.press import Press

pytestmark = pytest.mark.slow


@cache
def viewer() -> PressViewer:
    return PressViewer(calibrated(count=0), PROFILES["accurate"], load_networks()["accurate"])


def seen(press: KnownPress) -> PressView:
    view = viewer().view(press)
    assert view is not None
    return view


def test_balls_are_seen_where_they_are_and_as_large_as_they_are() -> None:
    for press in presses():
        view = seen(press)
        assert math.hypot(view.x_mm - (press.x_mm or 0), view.y_mm - (press.y_mm or 0)) < 0.8, press.name
        assert view.ball_factor > 0.8, press.name
        assert view.ball_factor < 1.5 or view.misfit_ratio < 4, press.name
        assert viewer().touches(press.image)


@pytest.mark.parametrize(("stated", "low", "high"), [(2.0, 0.4, 0.62), (0.5, 1.6, 2.6)])
def test_a_ball_of_another_radius_is_seen(stated: float, low: float, high: float) -> None:
    deep = [press for press in presses() if press.depth_mm > 1]
    factors = [seen(replace(press, radius_mm=stated * press.radius_mm)).ball_factor for press in deep]
    assert low < float(np.median(factors)) < high


def test_another_indenter_is_located_beside_its_stated_place() -> None:
    image = simulated(HALF).frame((Press(ridge(8.0, 6.0), 3.0, -2.0, 2.0),), 9).image
    stated = KnownPress("square", image, 0.0, 2.0, 3.0, -2.0, box("square", 8.0, 6.0))
    assert math.hypot(seen(stated).x_mm - 3.0, seen(stated).y_mm + 2.0) < 0.6
    moved = seen(replace(stated, x_mm=6.0))
    assert math.hypot(moved.x_mm - 3.0, moved.y_mm + 2.0) < 1.2
    assert math.isnan(moved.ball_factor)


def test_the_free_skin_shows_no_press() -> None:
    assert viewer().view(replace(presses()[0], image=unloaded())) is None
    assert not viewer().touches(unloaded())
