from __future__ import annotations

import math

import numpy as np
import pytest

from tacshade_edge.rigid import turn
from tacshade_edge.simulator.drag import loads_of
from tacshade_edge.simulator.load import summed
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.press import Press, ball
from tacshade_edge.simulator.scene import skin_under

MODEL = SensorModel(sway=0.0)


def test_pressure_pushes_along_the_radius_and_traction_pulls_against_the_skins_drag() -> None:
    direction = np.array(((0.0, 0.0, 1.0), (0.6, 0.0, 0.8)))
    load = summed(direction, 20 * direction, np.array((2.0, 1.0)), np.array(((1.0, 0.0), (0.0, -1.0))), 0.25, 0.0)
    assert load.normal_mm3 == pytest.approx(0.75)
    assert load.shear_mm3 == pytest.approx(0.5)
    assert load.push_mm3 == pytest.approx((0.15, 0.0, 0.7))
    assert load.pull_mm3 == pytest.approx((-0.25, 0.25, 0.0))
    assert load.torque_mm4 == pytest.approx((-0.25 * 16, -0.25 * 20, 0.25 * 12))
    assert load.margin(1.5) == pytest.approx(1 - 0.5 / (1.5 * 0.75))
    turned = load.turned(turn((0.0, 0.0, math.pi / 2)).rotation)
    assert turned.push_mm3 == pytest.approx((0.0, 0.15, 0.7))
    assert turned.shear_mm3 == load.shear_mm3


def test_a_contact_without_pressure_has_no_margin() -> None:
    nothing = np.zeros((0, 3))
    assert summed(nothing, nothing, np.zeros(0), np.zeros((0, 2)), 0.25, 0.0).margin(1.5) == 0.0


@pytest.mark.slow
def test_a_skin_pushes_a_ball_as_its_pressure_does() -> None:
    def normal(depth_mm: float) -> float:
        press = (Press(ball(20.0), depth_mm=depth_mm),)
        (load,) = loads_of(skin_under(MODEL, press), MODEL, press)
        assert load.push_mm3 == pytest.approx((0, 0, load.normal_mm3), rel=0.05, abs=0.01)
        assert load.shear_mm3 == 0
        return load.normal_mm3

    # A membrane on a foundation: ∫ h over the contact, and its edge's pull on the skirt, λ times the slope around it.
    shallow, deep = normal(1.0), normal(2.0)
    assert 2.5 < deep / shallow < 4.0


@pytest.mark.slow
def test_a_drag_one_way_and_the_other_are_alike_and_a_twist_cancels_out() -> None:
    def load(**drag: float):  # type: ignore[no-untyped-def]
        press = (Press(ball(20.0), depth_mm=1.5, **drag),)
        return loads_of(skin_under(MODEL, press), MODEL, press)[0]

    one, other, twisted = load(drag_x_mm=1.0), load(drag_x_mm=-1.0), load(twist_deg=10.0)
    assert one.pull_mm3[0] == pytest.approx(-other.pull_mm3[0], rel=0.01)
    assert one.pull_mm3[0] < 0
    assert one.shear_mm3 == pytest.approx(-one.pull_mm3[0], rel=0.05)
    assert np.linalg.norm(twisted.pull_mm3[:2]) < 0.01 * twisted.shear_mm3
    assert twisted.torque_mm4[2] < 0
    assert load(drag_x_mm=4.0).surplus > 0.3
    assert one.surplus < 1e-3
