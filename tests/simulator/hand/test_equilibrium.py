"""Where a held object comes to rest under a load, and that it slips under too great a one."""

from __future__ import annotations

import numpy as np
import pytest
from support.held_ball import BALL_MM, HOME, three_fingers

from tacshade_edge.simulator.hand.bodies import sphere
from tacshade_edge.simulator.hand.equilibrium import Rest, Wrench, borne, equilibrium
from tacshade_edge.simulator.hand.held import Placement, felt

pytestmark = pytest.mark.slow
BALL = sphere(BALL_MM)
THREE = three_fingers()
MU = 0.8


def rest(force: tuple[float, float, float], torque: tuple[float, ...] = (0, 0, 0)) -> Rest | None:
    start = Placement(HOME)
    grips = [felt(finger, finger.hand_T_sensor, BALL, HOME).grip for finger in THREE]
    return equilibrium(THREE, BALL, start, grips, Wrench(np.array(force, float), np.array(torque, float)), MU)


@pytest.mark.parametrize("force", [(0.0, 0.0, -60.0), (0.0, 150.0, 0.0), (40.0, 80.0, 20.0)])
def test_the_fingers_bear_the_weight(force: tuple[float, float, float]) -> None:
    found = rest(force)
    assert found is not None
    pressed = sum(each.truth.load.normal_mm3 for each in found.felts if each.truth.load)
    inner = borne(found.felts, THREE, found.hand_T_object, MU)
    assert np.linalg.norm(inner.force_mm3 + force) < 0.012 * (pressed + np.linalg.norm(force))
    assert np.linalg.norm(inner.torque_mm4) < 0.012 * 20 * (pressed + np.linalg.norm(force))
    moved = found.hand_T_object.translation_mm
    assert moved @ np.array(force) > 0, "it gives way in the direction of the load"
    assert np.linalg.norm(moved) < 1.5


def test_a_torque_turns_it() -> None:
    found = rest((0.0, 0.0, 0.0), (0.0, 4000.0, 0.0))
    assert found is not None
    _, x, y, z = found.hand_T_object.seven()[3:]
    assert y > 0.002
    assert abs(x) + abs(z) < 0.1 * y


def test_what_friction_does_not_bear_slips() -> None:
    pressed = sum(felt(f, f.hand_T_sensor, BALL, HOME).truth.load.normal_mm3 for f in THREE)  # type: ignore[union-attr]
    within, beyond = rest((0.0, 0.8 * MU * pressed, 0.0)), rest((0.0, 1.1 * MU * pressed, 0.0))
    assert within is not None
    assert all(0 < each.truth.margin < 0.4 for each in within.felts)
    assert beyond is None
