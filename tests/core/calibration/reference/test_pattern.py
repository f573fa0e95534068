from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree
from support.calibrated_sensor import FULL, HALF, TACTIP, random_sensor, references, simulated

from tacshade_edge.core.calibration.reference.pattern import find_disc, marker_pitch_px, mean_image
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.errors import ConfigError
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.prints import print_features
from tacshade_edge.simulator.render import project
from tacshade_edge.simulator.skin import chart_to_direction
from tacshade_edge.types import U8
from tools.testbed.simulator.families import sensor_name

MODELS = {"half": HALF, "tactip": TACTIP, "full": FULL} | {f"random {k}": random_sensor(k) for k in range(6)}


def mean_reference(model: SensorModel) -> U8:
    return mean_image([to_grey(image) for image in references(model, 5 if model is HALF else 3)])


def tip_pitch_px(model: SensorModel) -> float:
    """Mean distance of neighbouring pin tips, projected, in the middle of the disc: what the camera sees."""
    chart = print_features(model).pin_chart_mm
    along = chart_to_direction(chart[:, 0], chart[:, 1], model.skin_radius_mm)
    tips = along * (model.skin_radius_mm - model.pin_length_pitches * model.pitch_mm)
    seen = project(model.geometry, tips)
    middle = np.hypot(seen[:, 0] - model.col_c, seen[:, 1] - model.row_c) < 0.25 * model.disc_radius_px
    return float(cKDTree(seen).query(seen[middle], 7)[0][:, 1:].mean())


@pytest.mark.parametrize("name", MODELS)
def test_the_visible_circle_and_the_pitch_are_found(name: str) -> None:
    model = MODELS[name]
    grey = mean_reference(model)
    disc = find_disc(grey)
    assert np.hypot(disc.row_c - model.row_c, disc.col_c - model.col_c) < 0.5
    assert disc.radius_px == pytest.approx(model.disc_radius_px, rel=0.005)
    assert marker_pitch_px(grey, disc) == pytest.approx(tip_pitch_px(model), rel=0.03)


@pytest.mark.parametrize("name", ["other:33", "other:55", "other:56", "123"])
def test_neither_a_marker_that_the_rim_cuts_nor_a_coarse_faint_rim_moves_the_circle(name: str) -> None:
    sensor = sensor_name(name).make()
    disc = find_disc(to_grey(sensor.frame((), 1000).image))
    assert disc.radius_px == pytest.approx(sensor.model.disc_radius_px, rel=0.005)


def test_models_under_test_have_both_surrounds() -> None:
    assert {model.surround for model in MODELS.values()} == {"bright", "dark"}


def board(cell: int) -> U8:
    return (np.indices((240, 320)).sum(axis=0) // cell % 2 * 200 + 20).astype(np.uint8)


def disc_of_light() -> U8:
    image = np.zeros((240, 320), np.uint8)
    cv2.circle(image, (160, 120), 90, 200, -1)
    return image


NO_SENSOR = {
    "black": np.zeros((240, 320), np.uint8),
    "grey": np.full((240, 320), 128, np.uint8),
    "white": np.full((240, 320), 255, np.uint8),
    "noise": np.random.default_rng(1).integers(0, 256, (240, 320), dtype=np.uint8),
    "weak noise": np.random.default_rng(2).normal(100, 3, (240, 320)).astype(np.uint8),
    "ramp": np.tile(np.linspace(0, 255, 320).astype(np.uint8), (240, 1)),
    "one pixel": np.zeros((1, 1), np.uint8),
    "2x2": np.array([[0, 255], [255, 0]], np.uint8),
    "line": np.random.default_rng(3).integers(0, 256, (1, 320), dtype=np.uint8),
    "10x10": np.random.default_rng(3).integers(0, 256, (10, 10), dtype=np.uint8),
    "disc without markers": disc_of_light(),
}


@pytest.mark.parametrize("name", NO_SENSOR)
def test_what_is_no_sensor_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        marker_pitch_px(NO_SENSOR[name], find_disc(NO_SENSOR[name]))
    assert "reference" in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert "nan" not in str(refusal.value)


@pytest.mark.parametrize("cell", [1, 3, 8, 20])
def test_a_pattern_that_ends_only_with_the_image_has_no_circle(cell: int) -> None:
    with pytest.raises(ConfigError, match=r"found no visible circle|covers too little|no circle"):
        find_disc(board(cell))


CUT = {
    "a tenth": {"row_c": 80.0},
    "a third": {"row_c": 45.0},
    "a half": {"row_c": 10.0},
    "two sides": {"image_height_px": 160, "row_c": 80.0},
    "a corner": {"row_c": 80.0, "col_c": 80.0},
}


@pytest.mark.parametrize("name", CUT)
def test_a_circle_that_the_image_cuts_is_found(name: str) -> None:
    model = replace(HALF, **CUT[name])  # type: ignore[arg-type]
    disc = find_disc(to_grey(simulated(model).frame((), 0).image))
    assert np.hypot(disc.row_c - model.row_c, disc.col_c - model.col_c) < 1.5
    assert disc.radius_px == pytest.approx(model.disc_radius_px, rel=0.01)


def test_the_mean_rounds_and_does_not_wrap() -> None:
    levels = [np.full((2, 2), v, np.uint8) for v in (255, 255, 254)]
    mean = mean_image(levels)
    assert mean.dtype == np.uint8
    assert (mean == 255).all()
