"""Loads and slip of fingers that hold an object: they are the skin's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support.held_ball import BALL_MM, DEPTH_MM, HOME, MODEL, place, three_fingers

from tacshade_edge.rigid import shift, turn
from tacshade_edge.simulator.hand.bodies import box, sphere
from tacshade_edge.simulator.hand.held import Finger, HandTruth, Placement, felt, hold
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.types import Slip
from tools.testbed.simulator.families import OtherSensor, other_model

pytestmark = pytest.mark.slow
BALL = sphere(BALL_MM)
THREE = three_fingers()


def held_to(fingers: Sequence[Finger], *ys_mm: float) -> list[HandTruth]:
    """The ball, taken along y, across what the fingers lie in."""
    return [truth for truth, _ in hold(fingers, BALL, [Placement(shift(0, y, 0)) for y in ys_mm])]


def test_a_symmetric_grasp_has_equal_loads_that_cancel_out() -> None:
    ((truth, _),) = hold(THREE, BALL, [Placement(HOME)])
    loads = [finger.load for finger in truth.fingers]
    assert all(load is not None for load in loads)
    normals = [load.normal_mm3 for load in loads if load]
    assert normals == pytest.approx([normals[0]] * 3, rel=0.01)
    assert np.linalg.norm(sum(load.push_mm3 for load in loads if load)) < 0.01 * normals[0]
    assert [finger.depth_mm for finger in truth.fingers] == pytest.approx([DEPTH_MM] * 3, abs=0.01)
    assert [finger.margin for finger in truth.fingers] == pytest.approx([1.0] * 3)
    for finger in truth.fingers:
        assert finger.centre_mm is not None
        assert np.linalg.norm(finger.centre_mm) == pytest.approx(BALL_MM, abs=0.05)


def test_coulombs_law_is_never_exceeded_and_beyond_it_the_ball_slips() -> None:
    truths = held_to(THREE[:1], *np.arange(0.0, 4.0, 0.3).tolist())
    margins, slips = [t.fingers[0].margin for t in truths], [t.fingers[0].slip for t in truths]
    for truth in truths:
        load = truth.fingers[0].load
        assert load is not None
        # The solver's tolerance; see `friction`.
        assert load.shear_mm3 <= 1.03 * MODEL.coulomb * load.normal_mm3
        assert np.linalg.norm(load.pull_mm3) <= load.shear_mm3 + 1e-6
        assert load.pull_mm3[1] <= 1e-3, "what is taken along y is pulled back"
    onset = slips.index(Slip.FULL)
    assert slips[0] is Slip.STICK
    assert 3 < onset < 9
    assert set(slips[onset:]) == {Slip.FULL}
    assert all(a > b for a, b in pairwise(margins[:onset])), "it is ever less firm until it slips"
    assert set(margins[onset:]) == {0.0}
    assert truths[-1].motion.translation_mm == pytest.approx((0.0, 3.9, 0.0))


def test_a_contact_that_slid_is_loaded_the_other_way_as_soon_as_it_turns_back() -> None:
    way = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 4.0, 3.0, 2.0]
    *_, slid, _, back, farther = held_to(THREE[:1], *way)
    pulls = [t.fingers[0].load.pull_mm3[1] for t in (slid, back, farther) if t.fingers[0].load]
    assert slid.fingers[0].slip is Slip.FULL
    assert pulls[0] < 0 < pulls[1] < pulls[2]


def test_a_finger_that_is_drawn_back_lets_go_and_forgets() -> None:
    moved = shift(0.0, 1.0, 0.0)
    go = [Placement(HOME), Placement(moved), Placement(moved, (3.0, 3.0, 0.0)), Placement(moved)]
    truths = [truth for truth, _ in hold(THREE, BALL, go)]
    assert [f.press is None for f in truths[2].fingers] == [True, True, False]
    assert truths[2].fingers[0].slip is None
    assert truths[1].fingers[0].margin < 0.7
    assert [f.margin for f in truths[3].fingers] == pytest.approx([1.0, 1.0, truths[1].fingers[2].margin])
    assert truths[3].motion.translation_mm == pytest.approx((0.0, 1.0, 0.0)), "one finger held it all the time"
    opened = [*go, Placement(moved, (3.0,) * 3), Placement(moved)]
    assert [t for t, _ in hold(THREE, BALL, opened)][-1].motion.translation_mm == pytest.approx((0, 0, 0))


def test_a_box_that_is_turned_presses_one_finger_deeper_and_twists_another() -> None:
    side = 2 * BALL_MM
    body = box(side, 60.0, side)
    above, beside = (Finger(name, place(a), THREE[0].sensor) for name, a in (("above", 90.0), ("beside", 0.0)))
    (truth, _), (turned, _) = hold(
        [above, beside], body, [Placement(HOME), Placement(shift(0, 0, 0.4) @ turn((0, 0, 0.1)))]
    )
    assert turned.fingers[0].depth_mm == pytest.approx(truth.fingers[0].depth_mm + 0.4, abs=0.02)
    assert turned.fingers[0].press is not None
    assert abs(turned.fingers[0].press.twist_deg) == pytest.approx(np.degrees(0.1), abs=0.01)
    # The face beside turns by 0.1 about z: its contact goes 4 mm along y, and up by 0.4 mm with the box.
    assert turned.fingers[1].press is not None
    drag = np.hypot(turned.fingers[1].press.drag_x_mm, turned.fingers[1].press.drag_y_mm)
    assert drag == pytest.approx(np.hypot(BALL_MM * np.sin(0.1), 0.4), abs=0.1)


def test_what_rests_is_solved_once() -> None:
    class Counting(SimulatedSensor):
        solved = 0

        def skin(self, presses=()):  # type: ignore[no-untyped-def]
            self.solved += 1
            return super().skin(presses)

    sensor = Counting(MODEL)
    rests = Placement(HOME)
    truths = [t for t, _ in hold([Finger("one", place(90), sensor)], BALL, [rests] * 50)]
    assert sensor.solved == 1
    assert truths[0].fingers[0] is truths[-1].fingers[0]


def test_another_family_of_skin_holds_by_its_own_mechanics() -> None:
    model = replace(other_model(3), coulomb=1.0)
    away = BALL_MM + model.skin_radius_mm - DEPTH_MM
    truths = held_to([Finger("other", place(90, away), OtherSensor(model))], 0.0, 0.5, 1.0, 5.0)
    slips = [t.fingers[0].slip for t in truths]
    assert slips[:2] == [Slip.STICK, Slip.STICK]
    assert slips[-1] is Slip.FULL
    for truth in truths:
        load = truth.fingers[0].load
        assert load is not None
        assert load.shear_mm3 <= 1.03 * model.coulomb * load.normal_mm3


def test_an_object_in_the_middle_of_a_sensor_is_refused() -> None:
    with pytest.raises(ValueError, match="reaches the sensor's centre"):
        felt(THREE[0], THREE[0].hand_T_sensor, BALL, shift(0.0, 0.0, 30.0))
