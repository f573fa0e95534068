"""A finger's press is the object as it lies; its drag and twist are those of the object."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.simulator.hand.bodies import box, cylinder, sphere
from tacshade_edge.simulator.hand.placed import Grip, contact_centre, moved_along, press_of, slid_on
from tacshade_edge.simulator.objects import Shape
from tacshade_edge.types import F64

RADIUS_MM = 20.0
BODIES = (box(60.0, 50.0, 40.0), cylinder(22.0, 80.0), sphere(30.0))
# A contact at the tip, and a rotation of the object by all of it.
VECTORS = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
SMALL = st.tuples(*[st.floats(-0.1, 0.1)] * 3)


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


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
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
    press = press_of(BODIES[0], now, RADIUS_MM, at_mm, moved_along(Grip(touched), now, at_mm))
    assert press.twist_deg == pytest.approx(twist_deg, abs=1e-6)
    points = np.random.default_rng(1).uniform(-8, 8, (40, 2))
    before = motion.inverse().apply(np.column_stack((points, np.full(40, 18.0))))[:, :2]
    assert np.abs(press.before_drag(points) - before).max() < 1e-9


@given(rotation=SMALL, along=st.tuples(*[st.floats(-2, 2)] * 3))
def test_what_a_tilt_does_beside_the_middle_is_within_the_stated_bound(
    rotation: tuple[float, ...], along: tuple[float, ...]
) -> None:
    touched = shift(0.0, 0.0, 45.0)
    motion = shift(0.0, 0.0, 19.0) @ shift(*along) @ turn(rotation) @ shift(0.0, 0.0, -19.0)
    now = motion @ touched
    middle = np.array((0.0, 0.0, 19.0))
    press = press_of(sphere(26.0), now, RADIUS_MM, middle, moved_along(Grip(touched), now, middle))
    points = np.random.default_rng(1).uniform(-3.5, 3.5, (200, 2))
    height = 19.0 - np.sum(points**2, axis=1) / (2 * RADIUS_MM)  # of a contact of 10 mm
    exact = motion.inverse().apply(np.column_stack((points, height)))[:, :2]
    angle = float(np.linalg.norm(rotation))
    bound = math.sin(angle) * float(19.0 - height.min()) + 2 * (1 - math.cos(angle)) * 5.0
    assert np.linalg.norm(press.before_drag(points) - exact, axis=1).max() <= bound + 1e-9


def test_what_slid_counts_no_more() -> None:
    touched = shift(0.0, 0.0, 45.0)
    at_mm = np.array((0.0, 0.0, 19.0))
    grip = Grip(touched)
    drag = moved_along(grip, shift(4.0, 0.0, 0.0) @ touched, at_mm)
    assert drag == pytest.approx((4.0, 0.0, 0.0))
    slid = slid_on(grip, drag, 0.5)
    assert moved_along(slid, shift(4.0, 0.0, 0.0) @ touched, at_mm) == pytest.approx((2.0, 0.0, 0.0))
    assert moved_along(slid, shift(1.0, 0.0, 0.0) @ touched, at_mm) == pytest.approx((-1.0, 0.0, 0.0))
    assert slid_on(grip, drag, 0.0) is grip


def test_an_object_above_the_skin_does_not_touch() -> None:
    assert contact_centre(sphere(30.0), shift(0.0, 0.0, 50.001), RADIUS_MM) is None
