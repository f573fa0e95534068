"""Images from 1x1 to 4096x3072: what can be measured is, what cannot is refused, nothing breaks."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest
from support.built_sensor import built_calibration, marked
from support.extremes import EXTREME_IMAGES, noise
from support.soundness import sound_step

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.inputs import Sensor
from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.errors import ConfigError
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.types import U8, Calibration, Disc

SMALL = [(1, 1), (2, 3), (8, 8), (9, 8), (17, 300), (64, 64)]
LARGE = [(120, 160), (479, 641), (480, 640), (1200, 1600), (3072, 4096)]
# `paper`, with its iterations over every pixel, takes ten seconds for the last but one; the last takes each several.
LARGE_CASES = [(*size, profile) for size in LARGE[:-2] for profile in PROFILES]
LARGE_CASES += [(*size, "fast") for size in LARGE[-2:]]


def sensor_image(rows: int, cols: int) -> U8:
    disc = Disc((rows - 1) / 2, (cols - 1) / 2, 0.45 * min(rows, cols))
    image = marked(rows, cols, max(disc.radius_px / 10, 2.0), disc)
    return np.where(disc_mask(rows, cols, disc), image, np.uint8(5))


@cache
def whole_calibration(rows: int, cols: int) -> Calibration:
    return built_calibration(rows, cols, noise_grey=0.5)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(("rows", "cols"), SMALL)
def test_a_small_image_is_borne(profile: str, rows: int, cols: int) -> None:
    calibration = built_calibration(rows, cols, reference=sensor_image(rows, cols))
    made = make_reconstructor(calibration, PROFILES[profile])
    assert not sound_step(made, calibration.reference_grey).contact
    for image in (noise(1), EXTREME_IMAGES["white spike"], EXTREME_IMAGES["checkerboard 2 px"]):
        sound_step(made, image(rows, cols))


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "cols", "profile"), LARGE_CASES)
def test_a_press_is_found_at_every_size(rows: int, cols: int, profile: str) -> None:
    calibration = whole_calibration(rows, cols)
    made = make_reconstructor(calibration, PROFILES[profile])
    disc = calibration.geometry.disc
    assert not sound_step(made, calibration.reference_grey).contact
    pressed = marked(rows, cols, calibration.pitch_px, disc, pressed_px=0.4 * disc.radius_px)
    result = sound_step(made, pressed)
    assert result.contact
    x_mm, y_mm, _ = result.objects[0].centroid_mm
    assert np.hypot(x_mm, y_mm) < 2.0  # of 20


@pytest.mark.parametrize(("rows", "cols"), SMALL)
def test_what_is_too_small_is_not_calibrated(rows: int, cols: int) -> None:
    with pytest.raises(ConfigError, match=r"^found no .* in the reference") as refusal:
        calibrate(Sensor(20.0, 30.0, 50.0, "bright"), [sensor_image(rows, cols)])
    assert "\n" not in str(refusal.value)
    assert not re.search("nan|inf", str(refusal.value))


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "cols", "every"), [(8, 8, 1), (96, 128, 3), (480, 640, 11)])
def test_no_extreme_image_is_taken_for_a_sensor(rows: int, cols: int, every: int) -> None:
    for name, image in list(EXTREME_IMAGES.items())[::every]:
        with pytest.raises(ConfigError) as refusal:
            calibrate(Sensor(20.0, 30.0, 50.0, "bright"), [np.ascontiguousarray(image(rows, cols))])
        assert "\n" not in str(refusal.value), name
        assert not re.search("nan|inf", str(refusal.value)), name
