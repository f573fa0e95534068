from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from support.held_ball import BALL, DEPTH_MM, HOME, three_fingers
from tacshade_edge.lab.simulator.press import Shape
from tacshade_edge.lab.simulator.simulated_hand import (
    Grip,
    HandScript,
    Placement,
    contact_centre,
    felt,
    follow,
    lathed,
    moved_along,
    press_of,
)
from tacshade_edge.rigid import Rigid, shift, turn, turned_rad
from tacshade_edge.types import F64

CAN = lathed("can", ((-40.0, 22.0), (40.0, 22.0)))
POINTS = st.tuples(*[st.floats(-60, 60)] * 3)
RADIUS_MM = 20.0
BOTTLE = lathed("bottle", ((-50.0, 28.0), (16.0, 28.0), (42.0, 12.0)))
BODIES = (CAN, BOTTLE, BALL)
# A contact at the tip, and a rotation of the object by all of it.
VECTORS = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
SMALL = st.tuples(*[st.floats(-0.1, 0.1)] * 3)
AWAY = shift(2.0, 0.0, -4.0) @ turn((0.0, 0.6, 0.0))
THREE = three_fingers()


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
@given(one=POINTS, other=POINTS)
def test_a_ray_may_step_by_a_distance(
    body: Shape, one: tuple[float, ...], other: tuple[float, ...]
) -> None:
    p = np.array((one, other))
    a, b = body.sdf(p)
    assert abs(a - b) <= np.linalg.norm(p[0] - p[1]) + 1e-5


def over(
    body: Shape, rotation: tuple[float, ...], depth_mm: float, aside_mm: tuple[float, float]
) -> Rigid:
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
    return RADIUS_MM * np.stack((rho * np.cos(angle), rho * np.sin(angle), z), axis=-1).reshape(
        -1, 3
    )


@pytest.mark.slow
@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
@given(
    rotation=VECTORS, aside=st.tuples(*[st.floats(-5, 5)] * 2), moved=SMALL, seed=st.integers(0, 99)
)
def test_a_press_puts_the_objects_surface_where_it_is(
    body: Shape,
    rotation: tuple[float, ...],
    aside: tuple[float, float],
    moved: tuple[float, ...],
    seed: int,
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


@pytest.mark.slow
@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
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
    press = press_of(CAN, now, RADIUS_MM, at_mm, moved_along(Grip(touched), now, at_mm))
    assert press.twist_deg == pytest.approx(twist_deg, abs=1e-6)
    points = np.random.default_rng(1).uniform(-8, 8, (40, 2))
    before = motion.inverse().apply(np.column_stack((points, np.full(40, 18.0))))[:, :2]
    assert np.abs(press.before_drag(points) - before).max() < 1e-9


def test_object_and_fingers_go_straight_from_knot_to_knot() -> None:
    script = (
        HandScript((0.0,), (Placement(HOME, (3.0, 0.0)),))
        .fingers_back((0.0, 1.0), 2.0)
        .moved(AWAY, 1.0)
        .held(1.0)
    )
    assert script.times_s == (0.0, 2.0, 3.0, 4.0)
    assert script.at(0.5).back_mm == pytest.approx((2.25, 0.25))
    between = script.at(2.5)
    assert between.back_mm == (0.0, 1.0)
    assert between.hand_T_object.translation_mm == pytest.approx((1.0, 0.0, -2.0))
    assert turned_rad(between.hand_T_object.rotation) == pytest.approx((0.0, 0.3, 0.0))
    assert script.at(2.0).hand_T_object.seven() == pytest.approx(HOME.seven())


@pytest.mark.slow
def test_an_object_in_the_middle_of_a_sensor_is_refused() -> None:
    with pytest.raises(ValueError, match="reaches the sensor's centre"):
        felt(THREE[0], THREE[0].hand_T_sensor, BALL, shift(0.0, 0.0, 30.0))


@pytest.mark.slow
def test_a_finger_slides_beyond_coulombs_law_forgets_what_it_lets_go_and_rests_for_nothing() -> (
    None
):
    taken = [Placement(shift(0.0, y_mm, 0.0)) for y_mm in (0.0, 1.0, 6.0)]
    go = [*taken, taken[-1], Placement(taken[-1].hand_T_object, (3.0,)), taken[-1]]
    stuck, dragged, slid, rests, away, again = follow(THREE[:1], 0, BALL, go)
    assert stuck.press is not None
    assert stuck.skin.pressed_mm.max() == pytest.approx(DEPTH_MM, abs=0.01)
    assert stuck.grip is not None
    assert dragged.grip is not None
    assert slid.grip is not None
    assert math.hypot(*dragged.grip.slid[:2]) < 0.1 < 2 < math.hypot(*slid.grip.slid[:2])
    assert rests is slid
    assert (away.press, away.grip) == (None, None)
    assert again.grip is not None
    assert again.grip.slid == (0.0, 0.0, 0.0)
