"""Pads: the limit of domes of growing radius, of the same size and with the same lens."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.calibrated_sensor import HALF
from support.examples import examples
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball
from tacshade_edge.lab.simulator.sensor_model import SensorModel, flattened
from tacshade_edge.lab.simulator.skin import press_skin, undeformed
from tacshade_edge.lab.simulator.truth import SimulatedSensor

SIZE_MM, DECAY_MM, FLAT_MM = 20.0, 2.2, 1e4
PAD = flattened(HALF)


def nearly_flat(model: SensorModel, radius_mm: float = FLAT_MM) -> SensorModel:
    """The dome of a radius with a pad's visible circle, as far from the lens."""
    assert model.camera_distance_mm is not None
    half = math.asin(model.geometry.visible_radius_mm / radius_mm)
    return replace(
        model,
        skin="dome",
        skin_radius_mm=radius_mm,
        visible_half_angle_deg=math.degrees(half),
        camera_distance_mm=model.camera_distance_mm - radius_mm * math.cos(half),
    )


@pytest.mark.slow
@examples(8)
@given(st.floats(2.0, 9.0), st.tuples(*[st.floats(-6.0, 6.0)] * 2), st.floats(0.05, 0.5))
def test_flat_domes_are_pressed_into_the_shape_of_a_pad(
    ball_mm: float, at: tuple[float, float], part: float
) -> None:
    press = Press(ball(ball_mm), *at, part * ball_mm)
    flat, dome = (
        press_skin(radius_mm, DECAY_MM, [press], size_mm=SIZE_MM)
        for radius_mm in (math.inf, FLAT_MM)
    )
    assert flat.step_mm == dome.step_mm == undeformed(SIZE_MM).step_mm
    assert flat.height_mm.shape == undeformed(SIZE_MM).height_mm.shape
    assert flat.height_mm.max() == pytest.approx(part * ball_mm, abs=0.05)  # between two nodes
    assert np.abs(flat.height_mm - dome.height_mm).max() < 0.1
    assert np.abs(flat.height_mm - dome.height_mm).mean() < 0.002


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(OBJECTS))
def test_sharp_objects_shape_both_alike_but_for_nodes_beside_walls(name: str) -> None:
    press = Press(OBJECTS[name](), 1.0, -2.0, 2.0, 20.0)
    flat, dome = (
        press_skin(radius_mm, DECAY_MM, [press], size_mm=SIZE_MM)
        for radius_mm in (math.inf, FLAT_MM)
    )
    assert np.abs(flat.height_mm - dome.height_mm).mean() < 0.02


@pytest.mark.slow
def test_a_pad_looks_like_a_flat_dome_and_measures_like_one() -> None:
    press = (Press(ball(5.0), 3.0, -2.0, 2.0),)
    flat, dome = (SimulatedSensor(each).frame(press) for each in (PAD, nearly_flat(PAD)))
    differs = np.abs(flat.image.astype(int) - dome.image) > 40
    assert differs.mean() < 0.01
    rounder = SimulatedSensor(nearly_flat(PAD, 60.0)).frame(press)
    assert (np.abs(flat.image.astype(int) - rounder.image) > 40).mean() > 0.05
    one, other = flat.truth(), dome.truth()
    inside = np.isfinite(one.height_mm)
    assert np.abs(one.height_mm - other.height_mm)[inside].mean() < 0.01
    assert (one.contact != other.contact).mean() < 0.01
    (row,), (col,) = np.array([120.0]), np.array([170.0])
    shears = [each.shear_mm(np.array([row]), np.array([col])) for each in (flat, dome)]
    np.testing.assert_allclose(shears[0], shears[1], atol=0.02)


def test_the_contact_of_a_ball_lies_on_the_ball() -> None:
    truth = SimulatedSensor(PAD).frame((Press(ball(6.0), 3.0, -2.0, 2.5),)).truth()
    assert truth.depth_max_mm == pytest.approx(2.5, abs=0.01)
    middle = (3.0, -2.0, 3.5)
    for points in (truth.points_mm, truth.object_points_mm):
        np.testing.assert_allclose(np.linalg.norm(points - middle, axis=1), 6.0, atol=0.03)
        assert points[:, 2].max() <= 0


def test_skin_that_sticks_to_an_object_goes_with_it_on_a_pad() -> None:
    sticky = replace(PAD, coulomb=50.0, pin_lag=0.0)
    frame = SimulatedSensor(sticky).frame((Press(ball(5.0), 1.0, 0.0, 2.0, drag_x_mm=1.5),))
    shear = frame.shear_mm(np.array([118.2]), np.array([163.8 + 6.0]))
    np.testing.assert_allclose(shear, [[1.5, 0.0]], atol=0.05)
    rim = frame.shear_mm(np.array([118.2]), np.array([163.8 - 100.0]))
    assert 0 < rim[0, 0] < 0.4  # it sways


def test_what_no_pad_has_is_refused() -> None:
    with pytest.raises(ValueError, match=r"bulge is 0\.1"):
        replace(PAD, bulge=0.1)
    with pytest.raises(ValueError, match="skin is 'flat'"):
        replace(PAD, skin="flat")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="lens behind"):
        replace(PAD, camera_distance_mm=-1.0)
    with pytest.raises(ValueError, match="reaches the sensor's centre"):
        press_skin(math.inf, DECAY_MM, [Press(ball(5.0), 0.0, 0.0, 19.0)], size_mm=SIZE_MM)


def test_a_flattened_sensor_keeps_its_visible_circle_and_lens() -> None:
    dome, flat = HALF.geometry, PAD.geometry
    assert flat.visible_radius_mm == pytest.approx(dome.visible_radius_mm)
    assert (flat.f_px, flat.mm_per_px) == pytest.approx((dome.f_px, dome.mm_per_px))
    assert flattened(replace(HALF, camera_distance_mm=None)).geometry.camera_distance_mm is None
