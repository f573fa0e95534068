"""Frames that no sensor makes, through every profile: finite, inside the skin, the same twice, fit for the wire."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import get_args

import numpy as np
import pytest
from built_sensor import built_calibration, marked
from extreme_images import EXTREME_IMAGES, Maker, makers
from hypothesis import given, settings
from hypothesis import strategies as st
from soundness import everything, sound_step

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.devices.network import make_reconstructor
from tacshade_edge.types import U8, Binarisation, Calibration, Disc, Frame, Polarity

ROWS, COLS, PITCH_PX = 96, 128, 8.0
DISC = Disc(47.3, 64.8, 42.0)


@cache
def calibration(polarity: Polarity, binarisation: Binarisation) -> Calibration:
    return built_calibration(
        ROWS, COLS, disc=DISC, pitch_px=PITCH_PX, polarity=polarity, binarisation=binarisation, noise_grey=0.5
    )


@cache
def made(profile: str, polarity: Polarity = "bright", binarisation: Binarisation = "adaptive") -> Reconstructor:
    return make_reconstructor(calibration(polarity, binarisation), PROFILES[profile])


def blended(part: float, maker: Maker, where_px: float) -> U8:
    """The reference with an extreme over it, wholly or in part, everywhere or in a patch: what a check may pass."""
    reference = marked(ROWS, COLS, PITCH_PX, DISC).astype(np.float64)
    row, col = np.ogrid[:ROWS, :COLS]
    here = np.hypot(row - DISC.row_c, col - DISC.col_c) < where_px
    mixed = (1 - part) * reference + part * maker(ROWS, COLS)
    return np.rint(np.where(here, mixed, reference)).astype(np.uint8)


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("name", ["constant 255", "checkerboard 8 px", "noise 0", "step, axis 0"])
def test_an_extreme_frame_is_borne(profile: str, name: str) -> None:
    sound_step(made(profile), EXTREME_IMAGES[name](ROWS, COLS))


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("polarity", get_args(Polarity))
def test_every_extreme_frame_is_borne(profile: str, polarity: Polarity) -> None:
    seen = [
        sound_step(made(profile, polarity), blended(part, image, where_px))
        for image in EXTREME_IMAGES.values()
        for part, where_px in ((1.0, 1e9), (0.5, 1e9), (1.0, 20.0), (0.6, 20.0))
    ]
    # The images reach every way out: a solver's answer, no contact, an invalid frame.
    assert {(result.valid, result.contact) for result in seen} == {(True, True), (True, False), (False, False)}


@cache
def always_asked(profile: str) -> Reconstructor:
    """With a gate that opens at any change, so that every frame that passes the check reaches the solver."""
    open_gate = replace(PROFILES[profile], gate_levels=0.0)
    return make_reconstructor(replace(calibration("bright", "adaptive"), noise_grey=0.0), open_gate)


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
@given(maker=makers(), part=st.floats(0.1, 1), where_px=st.floats(5, 60), over=st.none() | makers())
@settings(max_examples=300)
def test_any_frame_is_borne(profile: str, maker: Maker, part: float, where_px: float, over: Maker | None) -> None:
    image = blended(part, maker, where_px)
    if over is not None:
        image = np.where(over(ROWS, COLS) > 127, image, marked(ROWS, COLS, PITCH_PX, DISC))
    sound_step(always_asked(profile), image)


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("binarisation", get_args(Binarisation))
def test_other_binarisations_bear_them_too(profile: str, binarisation: Binarisation) -> None:
    for image in EXTREME_IMAGES.values():
        sound_step(made(profile, "bright", binarisation), image(ROWS, COLS))


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
def test_frames_before_a_frame_do_not_change_its_result(profile: str) -> None:
    pressed = marked(ROWS, COLS, PITCH_PX, DISC, pressed_px=18)
    first = make_reconstructor(calibration("bright", "adaptive"), PROFILES[profile]).step(Frame(0, 0, 0, pressed))
    later = make_reconstructor(calibration("bright", "adaptive"), PROFILES[profile])
    for name, image in EXTREME_IMAGES.items():
        later.step(Frame(0, 0, 0, np.ascontiguousarray(image(ROWS, COLS))))
        assert everything(later.step(Frame(0, 0, 0, pressed))) == everything(first), name
    assert first.contact
