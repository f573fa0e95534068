"""A picture that `calibrate` takes as a reference is never refused against itself, nor a skin in other light."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.built_sensor import SIZE, sparse_dome
from support.calibrated_sensor import HALF, TACTIP, references

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.inputs import Sensor
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.errors import ConfigError
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.types import U8, Calibration, Disc, Frame, Reconstruction

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
