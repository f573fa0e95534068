from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.core.touch.answer import PLAIN, touch_by_model, touch_without_labels
from tacshade_edge.core.touch.learning import learn
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.types import TouchedObject, TouchModel

RANDOM = np.random.default_rng(0)
FEATURES = RANDOM.normal(size=(80, 20)).astype(np.float32)
LABELS = FEATURES[:, :2].astype(np.float64) * 2
IMPRINTS = (FEATURES[:, :2] @ RANDOM.normal(size=(2, 7))).astype(np.float32)
OBJECT = TouchedObject(1, (0.0, 0.0, 19.0), (3.0, 3.0, 0.5), 1.5, 9.0)


@pytest.fixture(scope="module")
def model() -> TouchModel:
    found = learn(FEATURES, IMPRINTS, ("depth_mm", "force_z_n"), LABELS, np.arange(80), "n").model
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


def test_what_is_outside_the_labelled_range_is_named_and_the_rest_answered(model: TouchModel) -> None:
    any_imprint = np.zeros_like(model.imprint_precision)
    narrow = replace(model, low=np.float32([-9, 90]), high=np.float32([9, 99]), imprint_precision=any_imprint)
    touch = touch_by_model(narrow, FEATURES[0], IMPRINTS[0])
    assert touch.values["depth_mm"] is not None
    assert touch.values["force_z_n"] is touch.sigma["force_z_n"] is None
    assert touch.reason is not None
    assert touch.reason.code is ReasonCode.TOUCH_RANGE
    assert touch.reason.text == "outside the labelled range: force_z_n"


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


def test_without_shear_there_is_none() -> None:
    touch = touch_without_labels((OBJECT,), None)
    for name in ("shear_x_mm", "shear_y_mm", "twist_deg"):
        assert touch.values[name] is touch.sigma[name] is None
    assert touch.values["depth_mm"] == 1.5
