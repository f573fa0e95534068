"""Presses on a pad: the limit of those on domes of growing radius."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from support.flat_skins import dome_like, pad
from tacshade_edge.calibration.indenters import (
    Ball,
    Placed,
    ball_along,
    box,
    cone,
    cylinder,
    known_height,
    place,
    skin_z_mm,
    stated_ball,
)
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.press_machine import TouchPoint, fixed_indenter, from_travel
from tacshade_edge.rigid import Rigid, shift, turn

SOLIDS = {
    "flat": cylinder("flat", 4.0),
    "square": box("square", 6.0, 5.0),
    "tip": cone("tip", 90.0),
}


def placed(name: str, r_mm: float, x: float, y: float, depth_mm: float, tilt_deg: float) -> Placed:
    if name == "ball":
        return stated_ball(r_mm, x, y, depth_mm, 5.0)
    return place(SOLIDS[name], r_mm, x, y, depth_mm, 20.0, tilt_deg, -tilt_deg / 2)


@examples(40)
@given(
    st.sampled_from(["ball", *SOLIDS]),
    st.none() | st.floats(20.0, 60.0),
    st.tuples(*[st.floats(-6.0, 6.0)] * 2),
    st.floats(0.3, 5.0),
    st.floats(-20.0, 20.0),
)
def test_an_indenter_of_a_pad_is_that_of_a_flat_dome(
    name: str, lens_mm: float | None, at: tuple[float, float], depth_mm: float, tilt_deg: float
) -> None:
    flat, r_mm = pad(lens_mm), 1e4
    dome = dome_like(flat, r_mm)
    on_pad = placed(name, math.inf, *at, depth_mm, tilt_deg)
    on_dome = placed(name, r_mm, *at, depth_mm, tilt_deg)
    assert on_pad.depth_max_mm(math.inf) == pytest.approx(depth_mm, abs=1e-9)
    assert on_dome.depth_max_mm(r_mm) == pytest.approx(depth_mm, abs=0.02)
    assert on_pad.first_touch_mm(math.inf) == pytest.approx(0, abs=1e-9)
    found, expected = known_height(flat, on_pad, 28), known_height(dome, on_dome, 28)
    both = np.isfinite(found) & np.isfinite(expected) & (found > 0) & (expected > 0)
    assert np.count_nonzero((found > 0.3) & ~both) <= 2  # a cell at a sharp edge
    # A ray along a wall meets it elsewhere for a small change.
    off = np.sort(np.abs(found - expected)[both])
    assert off[: math.ceil(0.95 * len(off)) - 1].max(initial=0) <= 0.05


def test_a_ball_that_is_located_lies_at_its_contact() -> None:
    assert ball_along(math.inf, np.array((3.0, -2.0, -1.0)), 1.5, 4.0) == Ball(3.0, -2.0, 2.5, 4.0)
    assert skin_z_mm(math.inf, 3.0, 4.0) == 0


angles = st.tuples(*[st.floats(-0.4, 0.4)] * 3)


@given(angles, st.tuples(*[st.floats(-200.0, 200.0)] * 3))
def test_a_robot_presses_a_pad_on_a_fixed_ball(
    turned: tuple[float, float, float], at: tuple[float, float, float]
) -> None:
    held: Rigid = shift(*at) @ turn(turned)
    stated = TouchPoint(2.0, -3.0, 1.5)
    fixed = fixed_indenter(held, stated, 4.0, math.inf)
    again = fixed.touch(held, math.inf)
    assert (again.x_mm, again.y_mm, again.depth_mm) == pytest.approx((2.0, -3.0, 1.5), abs=1e-9)
    closer = fixed.touch(held @ shift(0.5, 0, 0.25), math.inf)
    assert (closer.x_mm, closer.depth_mm) == pytest.approx((1.5, 1.75), abs=1e-9)


def test_travel_from_first_touch_is_the_depth_on_a_pad() -> None:
    press = KnownPress("p", np.zeros((2, 2), np.uint8), 6.0, 1.2, 3.0, 0.0)
    assert from_travel(press, math.inf).depth_mm == 1.2
