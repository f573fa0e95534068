"""Simulated imprints: of presses like the table's, and of another shape at the same numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.reasons import ReasonCode
from tacshade_edge.sensor.touch.learning import learn
from tacshade_edge.sensor.touch.touch_answer import (
    PLAIN,
    belongs,
    coordinates,
    imprint_of,
    predict,
    touch_by_model,
    touch_without_labels,
)
from tacshade_edge.types import F32, F64, TouchedObject, TouchModel

RANDOM = np.random.default_rng(0)
FEATURES = RANDOM.normal(size=(80, 20)).astype(np.float32)
LABELS = FEATURES[:, :2].astype(np.float64) * 2
IMPRINTS = (FEATURES[:, :2] @ RANDOM.normal(size=(2, 7))).astype(np.float32)
OBJECT = TouchedObject(1, (0.0, 0.0, 19.0), (3.0, 3.0, 0.5), 1.5, 9.0)


def presses(rows: int, seed: int, roundness: float) -> tuple[F32, F32, F64]:
    """Features, imprints and depths of a ball on a dome:
    the rounder, the smaller at the same depth.
    """
    random = np.random.default_rng(seed)
    depth_mm = random.uniform(0.5, 3, rows)
    imprints = np.zeros((rows, 4))
    imprints[:, 0] = depth_mm
    imprints[:, 1] = imprints[:, 3] = np.sqrt(20 * depth_mm / (1 + roundness))
    imprints[:, 2] = np.cbrt(imprints[:, 1] ** 2 * depth_mm / 2)
    imprints += 0.05 * random.normal(size=imprints.shape)
    features = np.outer(depth_mm, np.linspace(0.5, 1, 30)) + 0.1 * random.normal(size=(rows, 30))
    return features.astype(np.float32), imprints.astype(np.float32), depth_mm[:, None]


@pytest.fixture(scope="module")
def ball_model() -> TouchModel:
    features, imprints, labels = presses(120, 1, 0.0)
    found = learn(
        features, imprints, np.ones(120), ("depth_mm",), labels, np.arange(120), "n"
    ).model
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("roundness", "least", "most"), [(0.0, 0.97, 1.0), (1.0, 0.0, 0.05), (4.0, 0.0, 0.0)]
)
def test_imprints_of_the_table_s_shape_belong_and_others_do_not(
    ball_model: TouchModel, roundness: float, least: float, most: float
) -> None:
    _, imprints, depth_mm = presses(200, 2, roundness)
    part = np.mean([belongs(ball_model, *one) for one in zip(depth_mm, imprints, strict=True)])
    assert least <= part <= most


def test_an_imprint_is_of_all_that_touches_and_its_length_the_greatest_object_s() -> None:
    first = TouchedObject(1, (0.0, 0.0, 19.0), (3.0, 4.0, 0.5), 1.0, 9.0)
    second = TouchedObject(2, (5.0, 0.0, 19.0), (1.0, 1.0, 0.5), 1.5, 7.0)
    np.testing.assert_allclose(imprint_of((first, second), 8.0), [1.5, 4, 2, 5], rtol=1e-6)


@pytest.fixture(scope="module")
def model() -> TouchModel:
    found = learn(
        FEATURES, IMPRINTS, np.ones(80), ("depth_mm", "force_z_n"), LABELS, np.arange(80), "n"
    ).model
    assert found is not None
    return found


def test_a_frame_like_the_table_is_answered(model: TouchModel) -> None:
    touch = touch_by_model(model, FEATURES[0], IMPRINTS[0])
    assert touch.reason is None
    for q, name in enumerate(("depth_mm", "force_z_n")):
        value, sigma = touch.values[name], touch.sigma[name]
        assert value is not None
        assert sigma is not None
        assert abs(value - LABELS[0, q]) < 3 * sigma


def test_a_light_press_has_the_ratios_of_a_deep_one() -> None:
    origin, direction = RANDOM.normal(size=(2, 9)).astype(np.float32)
    light, deep = coordinates(origin + np.outer((2, 20), direction).astype(np.float32), origin)[
        :, 9:
    ]
    np.testing.assert_allclose(light, deep, rtol=0.02)
    assert not coordinates(origin[None], origin)[:, 9:].any()


def test_a_model_learnt_without_ratios_answers_as_before(model: TouchModel) -> None:
    size = len(model.origin)
    plain = replace(
        model, metric=model.metric * (np.arange(2 * size) < size)[:, None].astype(np.float32)
    )
    older = replace(model, metric=model.metric[:size])
    np.testing.assert_allclose(
        predict(older, FEATURES[0])[0], predict(plain, FEATURES[0])[0], rtol=1e-5
    )


def test_one_unlike_it_is_not(model: TouchModel) -> None:
    touch = touch_by_model(model, np.full(20, 50.0, np.float32), IMPRINTS[0])
    assert touch.reason is not None
    assert touch.reason.code is ReasonCode.TOUCH_UNLIKE
    assert set(touch.values.values()) == set(touch.sigma.values()) == {None}


def test_one_whose_imprint_does_not_belong_to_the_numbers_is_not(model: TouchModel) -> None:
    touch = touch_by_model(model, FEATURES[0], IMPRINTS[0] + np.float32(3))
    assert touch.reason is not None
    assert touch.reason.code is ReasonCode.TOUCH_UNLIKE
    assert touch.reason.text == "the imprint is unlike the labelled object's imprint"
    assert set(touch.values.values()) == {None}


def test_a_frame_without_contact_is_answered_by_its_features_alone(model: TouchModel) -> None:
    assert touch_by_model(model, FEATURES[0], None) == touch_by_model(
        model, FEATURES[0], IMPRINTS[0]
    )
    assert touch_by_model(model, np.full(20, 50.0, np.float32), None).reason is not None


def test_what_is_outside_the_labelled_range_is_named_and_its_interval_reaches_back(
    model: TouchModel,
) -> None:
    any_imprint = np.zeros_like(model.imprint_precision)
    narrow = replace(
        model, low=np.float32([-9, 90]), high=np.float32([9, 999]), imprint_precision=any_imprint
    )
    touch = touch_by_model(narrow, FEATURES[0], IMPRINTS[0])
    assert touch.values["depth_mm"] is not None
    force_n, sigma_n = touch.values["force_z_n"], touch.sigma["force_z_n"]
    assert force_n is not None
    assert sigma_n is not None
    assert force_n + sigma_n >= 90
    assert touch.reason is not None
    assert touch.reason.code is ReasonCode.TOUCH_RANGE
    assert touch.reason.text == "outside the labelled range: force_z_n"
    far = touch_by_model(replace(narrow, high=np.float32([9, 91])), FEATURES[0], IMPRINTS[0])
    assert far.values["force_z_n"] is far.sigma["force_z_n"] is None
    assert far.reason == touch.reason


@pytest.mark.parametrize(("tilt_x_deg", "tilt_y_deg"), [(0, 0), (20, 0), (0, -15), (-12, 25)])
def test_without_labels_tilt_is_about_x_then_about_y(tilt_x_deg: float, tilt_y_deg: float) -> None:
    a, b = np.radians((tilt_x_deg, tilt_y_deg))
    about_x = np.array(((1, 0, 0), (0, np.cos(a), -np.sin(a)), (0, np.sin(a), np.cos(a))))
    about_y = np.array(((np.cos(b), 0, np.sin(b)), (0, 1, 0), (-np.sin(b), 0, np.cos(b))))
    x, y, z = (about_y @ about_x @ (0, 0, 1)).tolist()
    touch = touch_without_labels((replace(OBJECT, normal=(x, y, z), twist_deg=3.0),), (0.5, -0.25))
    assert tuple(touch.values) == PLAIN
    expected = (1.5, tilt_x_deg, tilt_y_deg, 0.5, -0.25, 3.0)
    assert tuple(touch.values.values()) == pytest.approx(expected, abs=1e-9)
