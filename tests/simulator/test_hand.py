from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.held_ball import BALL_MM, DEPTH_MM, HOME, MODEL, place, three_fingers

from tacshade_edge.rigid import Rigid, shift, turn, turned_rad
from tacshade_edge.simulator.hand import (
    Finger,
    Grip,
    HandScript,
    HandTruth,
    Placement,
    box,
    contact_centre,
    cylinder,
    felt,
    hold,
    lathed,
    moved_along,
    press_of,
    sphere,
)
from tacshade_edge.simulator.press import Shape
from tacshade_edge.simulator.truth import SimulatedSensor
from tacshade_edge.types import F64, Slip

BODIES = (box(40.0, 30.0, 20.0), cylinder(15.0, 50.0), sphere(18.0), lathed("can", ((-23.0, 13.0), (23.0, 13.0))))
POINTS = st.tuples(*[st.floats(-60, 60)] * 3)
RADIUS_MM = 20.0
HELD = (box(60.0, 50.0, 40.0), cylinder(22.0, 80.0), sphere(30.0))
# A contact at the tip, and a rotation of the object by all of it.
VECTORS = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
SMALL = st.tuples(*[st.floats(-0.1, 0.1)] * 3)
AWAY = shift(2.0, 0.0, -4.0) @ turn((0.0, 0.6, 0.0))
BALL = sphere(BALL_MM)
THREE = three_fingers()


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
@given(one=POINTS, other=POINTS)
def test_a_ray_may_step_by_a_distance(body: Shape, one: tuple[float, ...], other: tuple[float, ...]) -> None:
    p = np.array((one, other))
    a, b = body.sdf(p)
    assert abs(a - b) <= np.linalg.norm(p[0] - p[1]) + 1e-5


def test_distances_are_those_to_faces_edges_and_ends() -> None:
    assert box(40.0, 30.0, 20.0).sdf(np.array(((23.0, 5, 5), (0, 0, 0), (0, -18, 0)))) == pytest.approx((3, -10, 3))
    corner = np.array(((18.0 + 3, 13.0 + 4, 0.0),))  # from the middle of the rounding of an edge along z
    assert box(40.0, 30.0, 20.0).sdf(corner) == pytest.approx((3.0,))
    assert cylinder(15.0, 50.0).sdf(np.array(((0, 9.0, 12.0), (27, 0, 0), (0, 0, 0)))) == pytest.approx((0, 2, -15))
    assert sphere(18.0).sdf(np.array(((0, 0, 20.0),))) == pytest.approx((2.0,))


def over(body: Shape, rotation: tuple[float, ...], depth_mm: float, aside_mm: tuple[float, float]) -> Rigid:
    """``sensor_T_object`` of a body that is turned at will, so deep over a place near the tip."""
    turned = turn(rotation)
    x, y = aside_mm
    out = np.array((x, y, math.sqrt(RADIUS_MM**2 - x * x - y * y))) / RADIUS_MM
    away = 80.0
    for _ in range(200):  # towards O until it touches
        pose = shift(*((RADIUS_MM + away) * out).tolist()) @ turned
        gap = float(np.min(body.sdf(pose.inverse().apply(skin_points()))))
        away -= gap
        if gap < 1e-3:
            break
    return shift(*((RADIUS_MM + away - depth_mm) * out).tolist()) @ turned


def skin_points() -> F64:
    angle, z = np.meshgrid(np.linspace(0, 2 * math.pi, 60), np.linspace(0.4, 1, 60))
    rho = np.sqrt(1 - z * z)
    return RADIUS_MM * np.stack((rho * np.cos(angle), rho * np.sin(angle), z), axis=-1).reshape(-1, 3)


@pytest.mark.parametrize("body", HELD, ids=lambda body: body.name)
@given(rotation=VECTORS, aside=st.tuples(*[st.floats(-5, 5)] * 2), moved=SMALL, seed=st.integers(0, 99))
def test_a_press_puts_the_objects_surface_where_it_is(
    body: Shape, rotation: tuple[float, ...], aside: tuple[float, float], moved: tuple[float, ...], seed: int
) -> None:
    touched = over(body, rotation, 0.5, aside)
    now = shift(0.3, -0.2, -0.5) @ touched @ turn(moved)
    at_mm = contact_centre(body, now, RADIUS_MM)
    assume(at_mm is not None)
    assert at_mm is not None
    press = press_of(body, now, RADIUS_MM, at_mm, moved_along(Grip(touched), now, at_mm))
    points = np.random.default_rng(seed).uniform(-30, 30, (50, 3))
    expected = body.sdf(now.inverse().apply(points))
    assert np.abs(press.distance_mm(RADIUS_MM, points) - expected).max() < 1e-5
    assert np.abs(press.distance_mm(RADIUS_MM, points.astype(np.float32)) - expected).max() < 1e-4


@pytest.mark.parametrize("body", HELD, ids=lambda body: body.name)
@given(rotation=VECTORS, aside=st.tuples(*[st.floats(-5, 5)] * 2))
def test_the_middle_of_a_contact_lies_on_the_object_inside_the_skin(
    body: Shape, rotation: tuple[float, ...], aside: tuple[float, float]
) -> None:
    now = over(body, rotation, 1.5, aside)
    at_mm = contact_centre(body, now, RADIUS_MM)
    assert at_mm is not None
    assert np.linalg.norm(at_mm) < RADIUS_MM
    assert abs(float(body.sdf(now.inverse().apply(at_mm[None]))[0])) < 0.02


@given(rotation=VECTORS, along=st.tuples(*[st.floats(-3, 3)] * 3), twist_deg=st.floats(-20, 20))
def test_a_motion_along_the_skin_comes_through_exactly(
    rotation: tuple[float, ...], along: tuple[float, ...], twist_deg: float
) -> None:
    touched = shift(0.0, 0.0, 45.0) @ turn(rotation)
    motion = shift(*along) @ turn((0.0, 0.0, math.radians(twist_deg)))
    now = motion @ touched
    at_mm = np.array((2.0, -1.0, 19.0))
    press = press_of(HELD[0], now, RADIUS_MM, at_mm, moved_along(Grip(touched), now, at_mm))
    assert press.twist_deg == pytest.approx(twist_deg, abs=1e-6)
    points = np.random.default_rng(1).uniform(-8, 8, (40, 2))
    before = motion.inverse().apply(np.column_stack((points, np.full(40, 18.0))))[:, :2]
    assert np.abs(press.before_drag(points) - before).max() < 1e-9


def test_object_and_fingers_go_straight_from_knot_to_knot() -> None:
    script = HandScript((0.0,), (Placement(HOME, (3.0, 0.0)),)).fingers_back((0.0, 1.0), 2.0).moved(AWAY, 1.0).held(1.0)
    assert script.times_s == (0.0, 2.0, 3.0, 4.0)
    assert script.at(0.5).back_mm == pytest.approx((2.25, 0.25))
    between = script.at(2.5)
    assert between.back_mm == (0.0, 1.0)
    assert between.hand_T_object.translation_mm == pytest.approx((1.0, 0.0, -2.0))
    assert turned_rad(between.hand_T_object.rotation) == pytest.approx((0.0, 0.3, 0.0))
    assert script.at(2.0).hand_T_object.seven() == pytest.approx(HOME.seven())


def held_to(fingers: Sequence[Finger], *ys_mm: float) -> list[HandTruth]:
    """The ball, taken along y, across what the fingers lie in."""
    return [truth for truth, _ in hold(fingers, BALL, [Placement(shift(0, y, 0)) for y in ys_mm])]


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_an_object_in_the_middle_of_a_sensor_is_refused() -> None:
    with pytest.raises(ValueError, match="reaches the sensor's centre"):
        felt(THREE[0], THREE[0].hand_T_sensor, BALL, shift(0.0, 0.0, 30.0))
