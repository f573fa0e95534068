from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support import bad_pictures
from support.calibrated_sensor import HALF, calibrated, pressed, presses, unloaded
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.sensor_model import random_model
from tacshade_edge.reasons import text_of
from tacshade_edge.sensor.frame_check.camera_drift import (
    CameraLook,
    Drift,
    carried_too_far,
    carries_pattern,
    drift,
    look,
    shift_reason,
    shifted_too_far,
)
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.types import U8, Disc

DISC = Disc(HALF.row_c, HALF.col_c, HALF.disc_radius_px)


@pytest.fixture(scope="module")
def reference() -> CameraLook:
    calibration = calibrated(count=0)
    return look(calibration.reference_grey, calibration.geometry.disc, calibration.pitch_px)


def warped(image: U8, row_px: float, col_px: float, turn_deg: float = 0.0, zoom: float = 1.0) -> U8:
    """Move, turn and zoom about the middle of the visible circle."""
    matrix = cv2.getRotationMatrix2D((HALF.col_c, HALF.row_c), -turn_deg, zoom)
    matrix[:, 2] += col_px, row_px
    size = (image.shape[1], image.shape[0])
    return np.asarray(
        cv2.warpAffine(image, matrix, size, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


@settings(max_examples=15)
@given(st.floats(-12, 12), st.floats(-12, 12), st.floats(-2, 2), st.floats(0.98, 1.02))
def test_the_camera_is_found_wherever_it_went(
    reference: CameraLook, row_px: float, col_px: float, turn_deg: float, zoom: float
) -> None:
    found = drift(reference, warped(to_grey(unloaded()), row_px, col_px, turn_deg, zoom))
    assert found.still_part > 0.7
    assert (found.row_px, found.col_px) == pytest.approx((row_px, col_px), abs=0.1)
    assert found.turn_deg == pytest.approx(turn_deg, abs=0.1)
    assert found.zoom == pytest.approx(zoom, abs=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("shift_px", [0.0, 1.5, 6.0])
def test_a_press_does_not_hide_or_feign_a_move(reference: CameraLook, shift_px: float) -> None:
    for press in presses()[::4]:
        found = drift(reference, warped(to_grey(press.image), 0.0, shift_px))
        assert (found.row_px, found.col_px) == pytest.approx((0, shift_px), abs=0.15)
        assert bool(shift_reason(found, DISC)) == (shift_px > 0)
        assert shifted_too_far(found, DISC) == (shift_px > 2)


def test_light_and_focus(reference: CameraLook) -> None:
    free, touched = to_grey(unloaded()), to_grey(pressed("ball", 2.5).image)
    for image in (free, touched):
        assert drift(reference, camera_faults.gain(image, 0.9)).light_reason is None
        dim = drift(reference, camera_faults.gain(image, 0.7))
        assert dim.light == pytest.approx(0.7, abs=0.02)
        assert text_of(dim.light_reason).endswith(" times the light")
        assert "blurred or dirty" in text_of(
            drift(reference, bad_pictures.defocus(image, 1.5)).light_reason
        )
        ramp = 1 - 0.5 * np.linspace(0, 1, image.shape[1])[None, :]
        assert "the light falls differently" in text_of(
            drift(reference, (image * ramp).astype(np.uint8)).light_reason
        )


def test_what_cannot_be_compared_says_nothing(reference: CameraLook) -> None:
    grey = to_grey(unloaded())
    for image in (
        np.random.default_rng(1).integers(0, 256, grey.shape, dtype=np.uint8),
        0 * grey + 9,
        grey[::2, ::2],
    ):
        assert drift(reference, np.ascontiguousarray(image)) == Drift()
    for disc in (Disc(100, 100, 3), Disc(-500, 100, 80)):
        assert drift(look(grey, disc, 8.0), grey) == Drift()


@pytest.mark.slow
def test_good_presses_of_other_sensors_did_not_move_or_age() -> None:
    for seed in (8200, 8203):
        model = random_model(seed)
        calibration = calibrated(model, 0)
        old = look(calibration.reference_grey, calibration.geometry.disc, calibration.pitch_px)
        for press in presses(model, 10):
            found = drift(old, to_grey(press.image))
            assert shift_reason(found, calibration.geometry.disc) is found.light_reason is None


def test_a_camera_carries_all_of_the_pattern_and_a_soft_gel_not(reference: CameraLook) -> None:
    grey = to_grey(unloaded())
    rows, cols = np.indices(grey.shape, np.float32)
    row_c, col_c = DISC.row_c, DISC.col_c + 0.2 * DISC.radius_px
    away_px = np.maximum(np.hypot(rows - row_c, cols - col_c), 1)
    # A dent pushes the gel aside, by 4 px beside it and less and less to the disc's other side.
    decay = np.exp(-1.5 * (away_px / DISC.radius_px) ** 2)
    pushed = 4 * decay * np.minimum(away_px / (0.3 * DISC.radius_px), 1) / away_px
    gel = cv2.remap(
        grey, cols - pushed * (cols - col_c), rows - pushed * (rows - row_c), cv2.INTER_LINEAR
    )
    found = drift(reference, np.asarray(gel, np.uint8))
    assert shifted_too_far(found, DISC)
    assert not carried_too_far(found, DISC)
    for row_px, turn_deg, zoom in ((4.0, 0, 1), (0, 2, 1), (0, 0, 0.97), (-3, 1, 1.01)):
        found = drift(reference, warped(grey, row_px, 0.0, turn_deg, zoom))
        assert carries_pattern(found, DISC)
        assert carried_too_far(found, DISC) == shifted_too_far(found, DISC)
