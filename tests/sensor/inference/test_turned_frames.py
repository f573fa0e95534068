"""Frames of cameras that mirror are recognised, also where only the network refuses them; the order
of colours does not matter.
"""

from __future__ import annotations

import numpy as np
import pytest

from support.calibrated_sensor import (
    HALF,
    calibrated,
    pressed,
    random_sensor,
    references,
    sensor_of,
)
from support.calibrated_sensor import unloaded as untouched
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.inference.turned_frames import with_turn_of
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import F64, U8, Frame

REFUSED = Reason(ReasonCode.TORN, "torn")
MIRRORED = "torn; it passes mirrored left to right: has the camera or a program done that?"


def test_what_the_plain_judges_refuse_is_turned_for_every_profile() -> None:
    image = np.ascontiguousarray(np.fliplr(untouched()))
    for profile in PROFILES.values():
        assert with_turn_of(REFUSED, image, calibrated(), profile).text == MIRRORED


@pytest.mark.slow
def test_what_only_the_network_refuses_is_turned_by_one() -> None:
    # Its surround is black: only the pattern shows how it is turned.
    model = random_sensor(0)
    made = calibrate(sensor_of(model), references(model)).calibration
    profile = PROFILES["balanced"]
    for image in references(model)[:2]:
        mirrored = np.ascontiguousarray(np.fliplr(image))
        assert make_reconstructor(made, profile).step(_frame(mirrored)).reason is not None
        assert with_turn_of(REFUSED, mirrored, made, profile).text == MIRRORED
        assert with_turn_of(REFUSED, mirrored, made, PROFILES["paper"]) == REFUSED
        # One good frame between bad ones.
        assert with_turn_of(REFUSED, image, made, profile) == REFUSED


TINTS = {
    "warm": np.array([0.75, 0.95, 1.0]),
    "blue": np.array([1.0, 0.4, 0.2]),
    "red": np.array([0.15, 0.3, 1.0]),
    "blue and red lamps": np.linspace([1.0, 0.6, 0.3], [0.3, 0.6, 1.0], 320)[None],
}


def lit(image: U8, tint: F64) -> U8:
    """A picture in the light of coloured lamps, blue, green, red."""
    return np.asarray(np.clip(to_grey(image)[..., None] * tint, 0, 255), np.uint8)


@pytest.mark.parametrize("light", TINTS)
def test_pictures_with_red_and_blue_swapped_give_the_same_heights(light: str) -> None:
    tint = TINTS[light]
    made = calibrate(sensor_of(HALF), [lit(image, tint) for image in references()]).calibration
    reconstructor = make_reconstructor(made, PROFILES["balanced"])
    image = lit(pressed("ball", 2.0).image, tint)
    right, swapped = (
        reconstructor.step(_frame(each)) for each in (image, np.ascontiguousarray(image[..., ::-1]))
    )
    assert right.contact
    assert swapped.contact
    off_mm = np.nanmean(np.abs(right.height.height_mm - swapped.height.height_mm))
    assert off_mm < 0.01
    assert abs(right.depth_max_mm - swapped.depth_max_mm) < 0.1


def _frame(image: U8) -> Frame:
    return Frame(0, 0, 0, image)
