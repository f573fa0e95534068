from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball, distance_mm
from tacshade_edge.lab.simulator.render import Renderer, project
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import press_skin, undeformed
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.types import F32

MODEL = replace(SensorModel(), specular_spots=0, read_noise_grey=0.0, shot_noise_grey=0.0)


def white_ratio(model: SensorModel, *presses: Press) -> F32:
    """Mean of the binarised clean image over windows of about two pitches, 0 to 255."""
    renderer = Renderer(model)
    image = renderer.draw(press_skin(model.skin_radius_mm, model.skin_decay_mm, presses))
    local = cv2.boxFilter(image, -1, (81, 81))
    side = 2 * round(model.pitch_mm / model.geometry.mm_per_px)
    return np.asarray(
        cv2.blur(np.where(image > local, np.float32(255), np.float32(0)), (side, side))
    )


def rings(model: SensorModel) -> F32:
    """Distance of every pixel from the middle of the disc, in mm on a plane tangent to the apex."""
    rows, cols = np.mgrid[: model.image_height_px, : model.image_width_px]
    per_px = (model.skin_radius_mm + (model.camera_distance_mm or 0)) / model.geometry.f_px
    return np.asarray(np.hypot(rows - model.row_c, cols - model.col_c) * per_px, np.float32)


@pytest.mark.parametrize(
    ("name", "depth_mm"), [("ball", 1.0), ("ball", 3.0), ("cube", 3.0), ("cylinder", 3.0)]
)
def test_contact_brightens_and_its_concave_rim_darkens(name: str, depth_mm: float) -> None:
    change = white_ratio(MODEL, Press(OBJECTS[name](), 0.0, 0.0, depth_mm)) - white_ratio(MODEL)
    away = rings(MODEL)
    assert change[away < 2].mean() > 12
    rim = (away > 3) & (away < 9)
    assert change[rim].min() < -12


def test_projection_meets_the_formula_of_the_pinhole() -> None:
    geometry = MODEL.geometry
    theta = math.radians(50.0)
    rim = 20.0 * np.array([math.sin(theta), 0.0, math.cos(theta)])
    assert project(geometry, rim) == pytest.approx(
        (327.7 + 205.0, 236.4)
    )  # the rim is the visible circle
    f_px = 205.0 * (20.0 * math.cos(theta) + 14.0) / (20.0 * math.sin(theta))
    assert project(geometry, np.array([3.0, -2.0, 17.0])) == pytest.approx(
        (327.7 + f_px * 3.0 / 31.0, 236.4 - f_px * 2.0 / 31.0)
    )


def test_a_lone_marker_is_drawn_where_its_projection_is() -> None:
    # Pins out of the way and small markers: each blob's centre is where the formula puts the
    # marker.
    model = replace(
        MODEL,
        pin_tip_radius_pitches=0.02,
        pin_base_radius_pitches=0.02,
        marker_radius_pitches=0.12,
        surround="dark",
    )
    renderer = Renderer(model)
    image = renderer.draw(undeformed(20.0))
    marks = renderer.print.marker_chart_mm.mean(axis=1)
    u = marks / 20.0
    q = np.sum(u * u, axis=1) / 4
    points = 20.0 * np.stack((u[:, 0], u[:, 1], 1 - q), axis=1) / (1 + q)[:, None]
    near = project(model.geometry, points[np.linalg.norm(points[:, :2], axis=1) < 10])
    assert len(near) > 100
    errors = []
    for col, row in near:
        i, j = round(row), round(col)
        rows, cols = np.mgrid[i - 6 : i + 7, j - 6 : j + 7]
        weight = np.maximum(image[i - 6 : i + 7, j - 6 : j + 7] - 60.0, 0)
        errors.append(
            (np.sum(weight * rows) / weight.sum() - row, np.sum(weight * cols) / weight.sum() - col)
        )
    assert np.abs(np.mean(errors, axis=0)).max() < 0.05  # half a pixel would be the classic mistake
    assert np.abs(errors).max() < 0.4


def test_same_seed_same_frame_other_seed_other_noise(small_sensor: SimulatedSensor) -> None:
    press = (Press(OBJECTS["ball"](), 1.0, 2.0, 2.0),)
    one, same = small_sensor.frame(press, 4), SimulatedSensor(small_sensor.model).frame(press, 4)
    assert np.array_equal(one.image, same.image)
    assert not np.array_equal(one.image, small_sensor.frame(press, 5).image)


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
            origin, along = (
                np.array([u, v, 0.0]) * [geometry.mm_per_px, geometry.mm_per_px, 1],
                np.array([0, 0, 1.0]),
            )
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
    assert (
        np.abs(errors).max() < 0.04
    )  # where the skin lifts off by up to 0.02 mm along the slanted normal


def test_points_are_the_contact_pixels_skin(small_sensor: SimulatedSensor) -> None:
    press = Press(OBJECTS["cube"](), -3.0, 2.0, 3.0, 30.0)
    truth = small_sensor.frame((press,)).truth()
    assert len(truth.points_mm) == truth.contact.sum() > 100
    assert np.abs(distance_mm([press], 20.0, truth.points_mm)).max() <= 0.0201
    heights = 20.0 - np.linalg.norm(truth.points_mm, axis=1)
    assert heights == pytest.approx(truth.height_mm[truth.contact], abs=1e-4)
    assert truth.depth_max_mm == pytest.approx(np.nanmax(truth.height_mm))


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
        # Only deep presses beside the apex reach the middle.
        assert depth_mm == 8.0, error  # noqa: PT017
        return
    truth = frame.truth()
    disc = model.geometry.disc
    rows, cols = np.mgrid[:120, :160]
    inside = np.hypot(rows - disc.row_c, cols - disc.col_c) <= disc.radius_px
    assert np.array_equal(np.isfinite(truth.height_mm), inside)
    assert truth.height_mm[inside].min() >= 0
    assert truth.height_mm[inside].max() < 18.0
    assert np.isfinite(truth.points_mm).all()
