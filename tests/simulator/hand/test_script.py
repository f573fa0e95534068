from __future__ import annotations

import math

import numpy as np
import pytest

from tacshade_edge.rigid import Rigid, shift, turn, turned_rad
from tacshade_edge.simulator.hand.held import Placement
from tacshade_edge.simulator.hand.script import HandScript

HOME = Rigid(np.eye(3), np.zeros(3))
AWAY = shift(2.0, 0.0, -4.0) @ turn((0.0, 0.6, 0.0))


def test_object_and_fingers_go_straight_from_knot_to_knot() -> None:
    script = HandScript((0.0,), (Placement(HOME, (3.0, 0.0)),)).fingers_back((0.0, 1.0), 2.0).moved(AWAY, 1.0).held(1.0)
    assert script.times_s == (0.0, 2.0, 3.0, 4.0)
    assert script.at(0.5).back_mm == pytest.approx((2.25, 0.25))
    between = script.at(2.5)
    assert between.back_mm == (0.0, 1.0)
    assert between.hand_T_object.translation_mm == pytest.approx((1.0, 0.0, -2.0))
    assert turned_rad(between.hand_T_object.rotation) == pytest.approx((0.0, 0.3, 0.0))
    assert script.at(2.0).hand_T_object.seven() == pytest.approx(HOME.seven())


def test_what_rests_is_the_same_value() -> None:
    script = HandScript((0.0,), (Placement(HOME),)).held(1.0).moved(AWAY, 1.0)
    assert script.at(0.2) is script.at(0.9)
    assert script.at(2.5) is script.at(9.0)
    assert script.at(-1.0) is script.at(0.5)


@pytest.mark.parametrize("times_s", [(0.0, 0.0), (1.0, 0.0), (0.0, math.inf), (0.0, math.nan)])
def test_times_that_do_not_increase_are_refused(times_s: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="expected increasing numbers"):
        HandScript(times_s, (Placement(HOME), Placement(HOME)))
