from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.lab.simulator import pad as pads
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball, distance_mm
from tacshade_edge.lab.simulator.skin import press_skin
from tacshade_edge.rigid import from_seven, turn

RNG = np.random.default_rng(0)
POINTS = RNG.uniform((-12, -12, -6), (12, 12, 14), (4000, 3))
R_MM = 20.0


@pytest.mark.parametrize("name", OBJECTS)
def test_distance_never_overestimates(name: str) -> None:
    # A signed distance changes by no more than the way gone.
    sdf = OBJECTS[name]().sdf
    step = RNG.normal(0, 1, POINTS.shape)
    change = np.abs(sdf(POINTS + step) - sdf(POINTS))
    assert np.all(change <= np.linalg.norm(step, axis=1) + 1e-9)


@pytest.mark.parametrize("name", OBJECTS)
def test_lowest_point_has_z_zero(name: str) -> None:
    sdf = OBJECTS[name]().sdf
    x, y = np.meshgrid(np.linspace(-10, 10, 201), np.linspace(-10, 10, 201))

    def least(z: float) -> float:
        return float(sdf(np.stack((x.ravel(), y.ravel(), np.full(x.size, z)), axis=1)).min())

    assert least(-0.5) == pytest.approx(0.5, abs=0.02)
    assert -0.1 < least(0.001) < 0.02
    assert least(0.4) < -0.15


@given(st.floats(-180, 180), st.floats(0.5, 2))
@settings(max_examples=20)
def test_rotation_is_from_x_towards_y_and_scale_is_about_the_lowest_point(
    rotation: float, scale: float
) -> None:
    press = Press(OBJECTS["bar"](), 1.0, 2.0, 3.0, rotation, scale)
    a = np.radians(rotation)
    reach = (7.0 + 2.0) * scale  # the end of the bar
    end = np.array(
        [(1 + reach * np.cos(a), 2 + reach * np.sin(a), press.lowest_z_mm(20.0) + 2.0 * scale)]
    )
    assert distance_mm([press], 20.0, end)[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    "change", [{"x_mm": float("nan")}, {"depth_mm": float("inf")}, {"scale": 0.0}]
)
def test_a_press_that_is_not_a_number_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        Press(ball(), **change)


def test_a_ball_without_radius_is_refused() -> None:
    with pytest.raises(ValueError, match="radius_mm"):
        ball(0.0)


@pytest.mark.parametrize(("tilt_x_deg", "tilt_y_deg"), [(15.0, 0.0), (0.0, -25.0), (10.0, 10.0)])
def test_the_lowest_point_of_a_tilted_cylinder_is_its_rounded_rim(
    tilt_x_deg: float, tilt_y_deg: float
) -> None:
    press = Press(OBJECTS["cylinder"](), 1.0, 2.0, 3.0, 0.0, 1.1, tilt_x_deg, tilt_y_deg)
    tilt = math.acos(math.cos(math.radians(tilt_x_deg)) * math.cos(math.radians(tilt_y_deg)))
    lowest = 1.1 * (-(5.0 - 0.2) * math.sin(tilt) - 0.2 + 0.2 * math.cos(tilt))
    assert press.lowest_z_mm(R_MM) - press.origin_z_mm(R_MM) == pytest.approx(lowest, abs=5e-3)
    axis = np.linspace(-8, 8, 161)
    x, y = (v.ravel() for v in np.meshgrid(axis + 1.0, axis + 2.0))
    below = np.column_stack((x, y, np.full(x.shape, press.lowest_z_mm(R_MM))))
    assert distance_mm((press,), R_MM, below).min() == pytest.approx(0, abs=0.01)


def test_tilt_is_about_x_then_y() -> None:
    np.testing.assert_allclose(
        Press(ball(), tilt_x_deg=90.0).tilt() @ (0, 1, 0), (0, 0, 1), atol=1e-12
    )
    np.testing.assert_allclose(
        Press(ball(), tilt_y_deg=90.0).tilt() @ (1, 0, 0), (0, 0, -1), atol=1e-12
    )
    np.testing.assert_allclose(
        Press(ball(), tilt_x_deg=90.0, tilt_y_deg=90.0).tilt() @ (0, 1, 0), (1, 0, 0), atol=1e-12
    )


def test_where_a_point_was_before_it_was_dragged_and_turned() -> None:
    press = Press(ball(), 3.0, 1.0, 2.0, drag_x_mm=0.5, drag_y_mm=-0.25, twist_deg=90.0)
    assert press.is_dragged
    assert not Press(ball()).is_dragged
    np.testing.assert_allclose(press.before_drag(np.array([[3.0, 1.0]])), [[2.5, 1.25]])
    # From x towards y: what is now along y was along x.
    np.testing.assert_allclose(press.before_drag(np.array([[3.0, 2.0]])), [[3.5, 1.25]], atol=1e-12)


PAD_RNG = np.random.default_rng(3)
PAD = pads.touchpad()
RADIUS_MM = 20.0


def on_top(count: int = 4000) -> np.ndarray:
    x, y = PAD_RNG.uniform((0, 0), (PAD.width_mm, PAD.length_mm), (count, 2)).T
    return np.stack((x, y, PAD.height_mm(x, y)), axis=1)


def test_the_top_is_the_solids_surface() -> None:
    points = on_top()
    assert np.abs(PAD.distance_mm(points)).max() < 1e-9
    assert (PAD.distance_mm(points + np.array((0, 0, 0.3))) > 0).all()
    assert (PAD.distance_mm(points - np.array((0, 0, 0.2))) < 0).all()


def test_the_scan_covers_the_pad_at_one_depth() -> None:
    poses = pads.scan(PAD, 8.0, 2.0, RADIUS_MM)
    apex = np.stack([p.apply(np.array((0, 0, RADIUS_MM))) for p in poses])
    np.testing.assert_allclose(apex[:, 2], pads.BULGE_HEIGHT_MM - 2.0)
    assert (apex[:, :2].min(axis=0) == (0, 0)).all()
    np.testing.assert_allclose(apex[:, :2].max(axis=0), (PAD.width_mm, PAD.length_mm))
    assert np.linalg.norm(np.diff(apex, axis=0), axis=1).max() <= 8.0 + 1e-9


def test_the_skin_meets_what_lies_under_it() -> None:
    # Over the middle of the widest fence, tilted a little:
    # the deepest place is the tip's, less the tilt's part.
    pose = pads.about_apex(
        from_seven((71.1, 22.0, pads.BULGE_HEIGHT_MM - 2.0 + RADIUS_MM, 0, 1, 0, 0)),
        turn((0.05, 0, 0)),
        RADIUS_MM,
    )
    skin = press_skin(RADIUS_MM, 2.2, (Press(PAD.under(pose, RADIUS_MM), 0, 0, 0.0),))
    middle = skin.height_mm.shape[0] // 2
    assert skin.height_mm[middle, middle] == pytest.approx(2.0, abs=0.02)
    assert skin.height_mm.max() == pytest.approx(2.0, abs=0.1)
