"""A picture that `calibrate` takes as a reference is never refused against itself,
nor a skin in other light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.built_sensor import SPARSE, from_one_image, sparse_dome
from support.calibrated_sensor import (
    FULL,
    HALF,
    TACTIP,
    references,
    simulated,
    unloaded,
)
from tacshade_edge.calibration.reference.pattern import (
    Pattern,
    find_pattern,
    mean_image,
    view,
)
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Disc, Frame, Reconstruction


def test_the_mean_rounds_and_does_not_wrap() -> None:
    mean = mean_image([np.full((2, 2), v, np.uint8) for v in (255, 255, 254)])
    assert mean.dtype == np.uint8
    assert (mean == 255).all()


@pytest.mark.slow
def test_a_blurred_picture_has_less_focus_and_a_dark_one_less_contrast() -> None:
    grey = to_grey(unloaded(FULL))
    pattern, disc = find_pattern(grey), simulated(FULL).model.geometry.disc
    found = (pattern.disc.row_c, pattern.disc.col_c, pattern.disc.radius_px)
    assert found == pytest.approx((disc.row_c, disc.col_c, disc.radius_px), abs=1.5)
    sharp = view(grey, pattern)
    assert sharp.advice == ""
    blurred = [
        view(cv2.GaussianBlur(grey, (0, 0), sigma), pattern).focus for sigma in (1.0, 2.0, 3.0)
    ]
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


def test_a_disc_outside_of_the_image_shows_nothing() -> None:
    assert view(np.zeros((48, 64), np.uint8), Pattern(Disc(-900.0, 0.0, 10.0), 5.0)).focus == 0.0


def step(made: Reconstructor, image: U8) -> Reconstruction:
    return made.step(Frame(0, 0, 0, image))


BASES: dict[str, Callable[[], U8]] = {
    "dome": sparse_dome,
    "half": lambda: to_grey(references(HALF, 1)[0]),
    "tactip": lambda: to_grey(references(TACTIP, 1)[0]),
}

LOOKS = st.lists(
    st.one_of(
        st.builds(lambda gain: lambda grey: np.clip(gain * grey, 0, 255), st.floats(0.1, 3.0)),
        st.builds(
            lambda level: lambda grey: np.where(grey > level, 255.0, 0.0), st.floats(20, 150)
        ),
        st.builds(lambda part: lambda grey: part * grey + (1 - part) * 128, st.floats(0.05, 1.0)),
        st.builds(
            lambda sigma: lambda grey: cv2.GaussianBlur(grey, (0, 0), sigma), st.floats(0.5, 4.0)
        ),
        st.builds(
            lambda sigma: lambda grey: camera_faults.noise(np.uint8(grey), sigma, 1),
            st.floats(0, 40),
        ),
        st.builds(
            lambda part: (
                lambda grey: cv2.resize(grey, None, fx=part, fy=part, interpolation=cv2.INTER_AREA)
            ),
            st.floats(0.45, 1.0),
        ),
    ),
    max_size=3,
)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(
    name=st.sampled_from(sorted(BASES)), looks=LOOKS, polarity=st.sampled_from(["bright", "dark"])
)
def test_a_reference_is_never_refused_against_itself(name: str, looks: list, polarity: str) -> None:
    """By any check of any profile, whatever picture is taken as one."""
    image = BASES[name]().astype(np.float32)
    for look in looks:
        image = look(image).astype(np.float32)
    grey = np.rint(image).astype(np.uint8)
    try:
        calibration = from_one_image(grey, replace(SPARSE, polarity=polarity))
    except ConfigError:
        return
    for profile in PROFILES.values():
        result = step(make_reconstructor(calibration, profile), grey)
        assert result.valid, (profile.name, result.reason)
        assert result.degraded is None, (profile.name, result.degraded)
        assert not result.contact, profile.name


@pytest.mark.slow
def test_a_dome_of_sparse_pins_is_calibrated_and_felt() -> None:
    made = make_reconstructor(from_one_image(sparse_dome()), PROFILES["balanced"])
    for seed in range(1, 4):
        free = step(made, sparse_dome(seed))
        assert (free.valid, free.contact) == (True, False)
    felt = step(made, sparse_dome(9, pressed=True))
    assert (felt.valid, felt.contact) == (True, True)


@pytest.mark.slow
def test_a_longer_exposure_is_no_glare() -> None:
    """The camera of the raw TacTip frames lifts the dark by 24 levels in the first
    of each recording.
    """
    made = make_reconstructor(from_one_image(sparse_dome(contrast_grey=170)), PROFILES["balanced"])
    lifted = step(made, sparse_dome(1, exposure_grey=24, contrast_grey=170))
    assert (lifted.valid, lifted.contact, lifted.degraded) == (True, False, None)
