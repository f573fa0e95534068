"""A picture that `calibrate` takes as a reference is never refused against itself, nor a skin in other light."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from support.built_sensor import FIELD, PITCH_PX, SIZE, pins_px, sparse_dome
from support.calibrated_sensor import FULL, HALF, TACTIP, random_sensor, references, simulated, unloaded

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.inputs import Sensor
from tacshade_edge.core.calibration.reference.marker_field import choose_binarisation, find_markers
from tacshade_edge.core.calibration.reference.pattern import find_disc, marker_pitch_px, mean_image
from tacshade_edge.core.calibration.reference.view import Pattern, find_pattern, view
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.errors import ConfigError
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.render import print_features, project
from tacshade_edge.simulator.skin import chart_to_direction
from tacshade_edge.types import U8, Calibration, Disc, Frame, Reconstruction
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


@pytest.mark.parametrize("size", [1.0, 0.25, 0.21])
def test_each_pin_is_found_and_no_lamp_is_one(size: float) -> None:
    """Of pictures from 100 px on."""
    image = cv2.resize(sparse_dome(), None, fx=size, fy=size, interpolation=cv2.INTER_AREA)
    found = find_markers(image)
    assert found is not None
    true = (pins_px() + 0.5) * size - 0.5
    nearest = np.linalg.norm(found.markers_px[:, None] - true[None], axis=2).min(axis=1)
    assert len(found.markers_px) >= 0.97 * len(true)
    assert nearest.max() < max(0.15 * PITCH_PX * size, 1.0)
    assert found.pitch_px == pytest.approx(PITCH_PX * size, rel=0.06)


def test_the_circle_is_where_the_pins_end_not_where_the_lamps_do() -> None:
    disc = find_disc(sparse_dome())
    assert np.hypot(disc.row_c - FIELD.row_c, disc.col_c - FIELD.col_c) < 2
    assert disc.radius_px == pytest.approx(FIELD.radius_px, rel=0.06)


def test_a_thresholded_picture_and_a_small_one_have_a_pitch() -> None:
    rows, cols = np.ogrid[: SIZE[0], : SIZE[1]]
    near = np.hypot(rows - FIELD.row_c, cols - FIELD.col_c) < 180
    black_and_white: U8 = np.where(near & (sparse_dome() > 60), np.uint8(255), np.uint8(0))
    small = cv2.resize(black_and_white[72:432, 132:492], (100, 100), interpolation=cv2.INTER_AREA)
    for image, scale in ((black_and_white, 1.0), (small, 100 / 360)):
        disc = find_disc(image)
        assert disc.radius_px == pytest.approx(FIELD.radius_px * scale, rel=0.07)
        assert marker_pitch_px(image, disc) == pytest.approx(PITCH_PX * scale, rel=0.15)


@pytest.mark.parametrize("seed", range(3))
def test_noise_has_no_markers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert find_markers(rng.integers(0, 256, (240, 320), dtype=np.uint8)) is None
    assert find_markers(np.zeros((12, 12), np.uint8)) is None
    soft = cv2.GaussianBlur(rng.normal(100, 60, (480, 640)).astype(np.float32), (0, 0), 4)
    assert find_markers(np.clip(soft, 0, 255).astype(np.uint8)) is None


def test_what_the_markers_fill() -> None:
    image = sparse_dome()
    found = find_markers(image)
    assert found is not None
    assert found.holds(FIELD)
    assert not found.holds(Disc(FIELD.row_c, FIELD.col_c, 0.8 * FIELD.radius_px))
    assert found.filled_part(FIELD, image.shape) > 0.9
    assert found.filled_part(Disc(FIELD.row_c, FIELD.col_c, 283.0), image.shape) < 0.5
    assert found.filled_part(Disc(-500.0, -500.0, 50.0), image.shape) == 0.0


def test_pins_that_stand_far_apart_are_split_from_the_noise_between_them() -> None:
    assert choose_binarisation(sparse_dome(noise_grey=5.0, contrast_grey=70.0), FIELD, PITCH_PX) == "otsu"


def test_little_noise_is_enough() -> None:
    assert choose_binarisation(sparse_dome(noise_grey=2.5, contrast_grey=70.0), FIELD, PITCH_PX) == "otsu"


def test_without_noise_the_mean_around_serves_them() -> None:
    assert choose_binarisation(sparse_dome(noise_grey=0.0), FIELD, PITCH_PX) == "adaptive"


@pytest.mark.parametrize("model", [HALF, FULL, TACTIP], ids=["half", "full", "tactip"])
def test_dense_patterns_keep_the_mean_around(model: SensorModel) -> None:
    grey = to_grey(references(model, 1)[0])
    disc = find_disc(grey)
    assert choose_binarisation(grey, disc, marker_pitch_px(grey, disc)) == "adaptive"


def test_what_has_no_markers_keeps_it_too() -> None:
    noise = np.random.default_rng(1).integers(0, 256, (240, 320), dtype=np.uint8)
    assert choose_binarisation(noise, FIELD, 9.0) == "adaptive"


@pytest.fixture(scope="module")
def grey() -> U8:
    return to_grey(unloaded(FULL))


@pytest.fixture(scope="module")
def pattern(grey: U8) -> Pattern:
    return find_pattern(grey)


def test_the_disc_is_that_of_the_whole_image(pattern: Pattern) -> None:
    disc = simulated(FULL).model.geometry.disc
    found = (pattern.disc.row_c, pattern.disc.col_c, pattern.disc.radius_px)
    assert found == pytest.approx((disc.row_c, disc.col_c, disc.radius_px), abs=1.5)


def test_a_blurred_picture_has_less_focus_and_a_dark_one_less_contrast(grey: U8, pattern: Pattern) -> None:
    sharp = view(grey, pattern)
    assert sharp.advice == ""
    blurred = [view(cv2.GaussianBlur(grey, (0, 0), sigma), pattern).focus for sigma in (1.0, 2.0, 3.0)]
    assert [sharp.focus, *blurred] == sorted([sharp.focus, *blurred], reverse=True)
    dark = view((grey // 8).astype(np.uint8), pattern)
    assert dark.focus == pytest.approx(sharp.focus, rel=0.1)
    assert dark.advice.startswith("too flat")
    bright = view(np.minimum(2.0 * grey, 255).astype(np.uint8), pattern)
    assert bright.saturated_part > 0.05
    assert bright.advice.startswith("too bright")


@pytest.mark.parametrize("shape", [(1, 1), (480, 640), (5, 4000)])
def test_an_empty_picture_has_no_pattern(shape: tuple[int, int]) -> None:
    with pytest.raises(ConfigError):
        find_pattern(np.zeros(shape, np.uint8))


def test_a_disc_outside_of_the_image_shows_nothing(grey: U8) -> None:
    assert view(grey, Pattern(Disc(-900.0, 0.0, 10.0), 5.0)).focus == 0.0


SENSOR = Sensor(20.0, 25.0, 50.0, "dark")


def calibrated(image: U8, sensor: Sensor = SENSOR) -> Calibration:
    return calibrate(sensor, [image], allow_loaded_reference=True).calibration


def step(made: Reconstructor, image: U8) -> Reconstruction:
    return made.step(Frame(0, 0, 0, image))


BASES = (
    sparse_dome(),
    to_grey(references(HALF, 1)[0]),
    to_grey(references(TACTIP, 1)[0]),
)
LOOKS = st.lists(
    st.one_of(
        st.builds(lambda gain: lambda grey: np.clip(gain * grey, 0, 255), st.floats(0.1, 3.0)),
        st.builds(lambda level: lambda grey: np.where(grey > level, 255.0, 0.0), st.floats(20, 150)),
        st.builds(lambda part: lambda grey: part * grey + (1 - part) * 128, st.floats(0.05, 1.0)),
        st.builds(lambda sigma: lambda grey: cv2.GaussianBlur(grey, (0, 0), sigma), st.floats(0.5, 4.0)),
        st.builds(
            lambda seed, sigma: (
                lambda grey: np.clip(grey + np.random.default_rng(seed).normal(0, sigma, grey.shape), 0, 255)
            ),
            st.integers(0, 99),
            st.floats(0, 40),
        ),
        st.builds(
            lambda rows: (
                lambda grey: cv2.resize(
                    grey, (round(rows * grey.shape[1] / grey.shape[0]), rows), interpolation=cv2.INTER_AREA
                )
            ),
            st.integers(100, 480),
        ),
    ),
    max_size=3,
)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(base=st.sampled_from(BASES), looks=LOOKS, polarity=st.sampled_from(["bright", "dark"]))
def test_a_reference_is_never_refused_against_itself(base: U8, looks: list, polarity: str) -> None:
    """By any check of any profile, whatever picture is taken as one."""
    image = base.astype(np.float32)
    for look in looks:
        image = look(image).astype(np.float32)
    grey = np.rint(image).astype(np.uint8)
    try:
        calibration = calibrated(grey, replace(SENSOR, polarity=polarity))
    except ConfigError:
        return
    for profile in PROFILES.values():
        result = step(make_reconstructor(calibration, profile), grey)
        assert result.valid, (profile.name, result.reason)
        assert result.degraded is None, (profile.name, result.degraded)
        assert not result.contact, profile.name


def test_a_dome_of_sparse_pins_is_calibrated_and_felt() -> None:
    made = make_reconstructor(calibrated(sparse_dome()), PROFILES["balanced"])
    for seed in range(1, 4):
        free = step(made, sparse_dome(seed))
        assert (free.valid, free.contact) == (True, False)
    felt = step(made, sparse_dome(9, pressed=True))
    assert (felt.valid, felt.contact) == (True, True)


def test_a_longer_exposure_is_no_glare() -> None:
    """The camera of the raw TacTip frames lifts the dark by 24 levels in the first of each recording."""
    made = make_reconstructor(calibrated(sparse_dome(contrast_grey=170)), PROFILES["balanced"])
    lifted = step(made, sparse_dome(1, exposure_grey=24, contrast_grey=170))
    assert (lifted.valid, lifted.contact, lifted.degraded) == (True, False, None)


def test_a_stated_circle_overrules_what_is_seen() -> None:
    stated = Disc(250.0, 310.0, 170.0)
    assert calibrated(sparse_dome(), replace(SENSOR, visible_circle=stated)).geometry.disc == stated
    with pytest.raises(
        ConfigError,
        match=r"^visible_circle: found a circle at row 9000, .*, expected a circle that overlaps the 640x480 px",
    ):
        calibrated(sparse_dome(), replace(SENSOR, visible_circle=Disc(9000.0, 310.0, 170.0)))
    assert SIZE == (480, 640)
