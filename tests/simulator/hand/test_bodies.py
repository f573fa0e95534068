from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.simulator.hand.bodies import box, cylinder, lathed, sphere
from tacshade_edge.simulator.objects import Shape

CAN = lathed("can", ((-23.0, 13.0), (23.0, 13.0)))
BODIES = (box(40.0, 30.0, 20.0), cylinder(15.0, 50.0), sphere(18.0), CAN)
POINTS = st.tuples(*[st.floats(-60, 60)] * 3)


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


def test_a_lathed_outline_is_rounded_around_its_corners() -> None:
    points = np.random.default_rng(0).uniform(-40, 40, (500, 3))
    assert CAN.sdf(points) == pytest.approx(cylinder(15.0, 50.0).sdf(points), abs=1e-9)


def test_edges_rounder_than_the_body_are_refused() -> None:
    with pytest.raises(ValueError, match=r"a box of 3 x 30 x 20 mm has no edges of radius 2\.0 mm"):
        box(3, 30, 20)
    with pytest.raises(
        ValueError, match=r"a cylinder of radius 1\.0 and length 50\.0 mm has no edges of radius 2\.0 mm"
    ):
        cylinder(1.0, 50.0)
