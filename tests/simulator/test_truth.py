import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.simulator.press import OBJECTS, Press, ball, distance_mm
from tacshade_edge.simulator.scene import SimulatedSensor


def test_no_contact_is_zero_inside_and_nan_outside(small_sensor: SimulatedSensor) -> None:
    truth = small_sensor.frame().truth()
    disc = small_sensor.model.geometry.disc
    rows, cols = np.mgrid[:120, :160]
    inside = np.hypot(rows - disc.row_c, cols - disc.col_c) <= disc.radius_px
    assert np.array_equal(np.isfinite(truth.height_mm), inside)
    assert not truth.height_mm[inside].any()
    assert not truth.contact.any()
    assert truth.points_mm.shape == (0, 3)
    assert truth.depth_max_mm == 0


@pytest.mark.parametrize("camera_distance_mm", [14.0, 6.0, None])
def test_height_under_a_ball_is_where_the_ray_meets_the_ball(
    small_sensor: SimulatedSensor, camera_distance_mm: float | None
) -> None:
    model = replace(small_sensor.model, camera_distance_mm=camera_distance_mm)
    x, radius, depth = 5.0, 6.0, 3.0
    truth = SimulatedSensor(model).frame((Press(ball(radius), x, 0.0, depth),)).truth()
    centre = np.array([x, 0.0, math.sqrt(400 - x * x) - depth + radius])
    rows, cols = np.nonzero(truth.contact)
    assert len(rows) > 100
    geometry = model.geometry
    errors = []
    for row, col in list(zip(rows, cols, strict=True))[::7]:
        u, v = col - geometry.disc.col_c, row - geometry.disc.row_c
        if camera_distance_mm is None:
            origin, along = np.array([u, v, 0.0]) * [geometry.mm_per_px, geometry.mm_per_px, 1], np.array([0, 0, 1.0])
        else:
            origin = np.array([0, 0, -camera_distance_mm])
            along = np.array([u / geometry.f_px, v / geometry.f_px, 1.0])
        along = along / np.linalg.norm(along)
        # The first meeting of the ray and the ball, by the quadratic formula.
        to_centre = centre - origin
        along_centre = to_centre @ along
        s = along_centre - math.sqrt(radius**2 - to_centre @ to_centre + along_centre**2)
        errors.append(truth.height_mm[row, col] - (20.0 - np.linalg.norm(origin + s * along)))
    assert np.median(np.abs(errors)) < 0.003
    assert np.abs(errors).max() < 0.04  # where the skin lifts off by up to 0.02 mm along the slanted normal


def test_points_are_the_contact_pixels_skin(small_sensor: SimulatedSensor) -> None:
    press = Press(OBJECTS["cube"](), -3.0, 2.0, 3.0, 30.0)
    truth = small_sensor.frame((press,)).truth()
    assert len(truth.points_mm) == truth.contact.sum() > 100
    assert np.abs(distance_mm([press], 20.0, truth.points_mm)).max() <= 0.0201
    heights = 20.0 - np.linalg.norm(truth.points_mm, axis=1)
    assert heights == pytest.approx(truth.height_mm[truth.contact], abs=1e-4)
    assert truth.depth_max_mm == pytest.approx(np.nanmax(truth.height_mm))


def test_the_skirt_is_deformed_but_not_contact(small_sensor: SimulatedSensor) -> None:
    truth = small_sensor.frame((Press(ball(5.0), 0.0, 0.0, 3.0),)).truth()
    skirt = (truth.height_mm > 0.2) & ~truth.contact
    assert skirt.sum() > 0.5 * truth.contact.sum()


@pytest.mark.slow
def test_a_flat_face_in_contact_is_flat(sensor: SimulatedSensor) -> None:
    truth = sensor.frame((Press(OBJECTS["cylinder"](), 0.0, 0.0, 3.0),)).truth()
    inner = np.hypot(truth.points_mm[:, 0], truth.points_mm[:, 1]) < 4.5
    assert truth.points_mm[inner, 2] == pytest.approx(17.0, abs=0.005)
    # The face of radius 5 less its rounding is all contact: its area is that of its pixels.
    radius = np.hypot(truth.points_mm[:, 0], truth.points_mm[:, 1])
    assert 4.6 < np.quantile(radius, 0.99) < 5.1


def test_object_points_are_on_the_object_inside_the_skin(small_sensor: SimulatedSensor) -> None:
    press = Press(OBJECTS["ring"](), 1.0, 1.0, 4.0)
    points = small_sensor.frame((press,)).truth().object_points_mm
    assert len(points) > 500
    assert np.abs(distance_mm([press], 20.0, points)).max() < 1e-3
    assert np.linalg.norm(points, axis=1).max() <= 20.0


@pytest.mark.slow
@given(
    name=st.sampled_from(sorted(OBJECTS)),
    x_mm=st.floats(-16, 16),
    y_mm=st.floats(-8, 8),
    depth_mm=st.sampled_from([0.0, 1e-3, 0.5, 8.0]),
)
@settings(max_examples=20, deadline=None)
def test_extreme_presses_have_finite_truth(
    small_sensor: SimulatedSensor, name: str, x_mm: float, y_mm: float, depth_mm: float
) -> None:
    model = small_sensor.model
    try:
        frame = small_sensor.frame((Press(OBJECTS[name](), x_mm, y_mm, depth_mm),))
    except ValueError as error:
        assert depth_mm == 8.0, error  # noqa: PT017 - only deep presses beside the apex reach the middle
        return
    truth = frame.truth()
    disc = model.geometry.disc
    rows, cols = np.mgrid[:120, :160]
    inside = np.hypot(rows - disc.row_c, cols - disc.col_c) <= disc.radius_px
    assert np.array_equal(np.isfinite(truth.height_mm), inside)
    assert truth.height_mm[inside].min() >= 0
    assert truth.height_mm[inside].max() < 18.0
    assert np.isfinite(truth.points_mm).all()
