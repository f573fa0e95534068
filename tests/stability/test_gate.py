"""An honest gate: what is no contact gives none, on sensors that brighten and sensors that darken,
in every profile.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from support.built_sensor import built_calibration
from support.calibrated_sensor import FULL, HALF, TACTIP, calibrated, pressed, simulated
from support.extremes import constant, ramp
from support.soundness import sound_step
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8

MODELS = {"full": FULL, "half": HALF, "tactip": TACTIP}
FRAMES = {"full": 10, "half": 40, "tactip": 40}


@cache
def made(profile: str, name: str) -> Reconstructor:
    return make_reconstructor(calibrated(MODELS[name], 0), PROFILES[profile])


@cache
def untouched(name: str) -> tuple[U8, ...]:
    """Frames of the simulated sensor, each with the noise of its own camera."""
    return tuple(simulated(MODELS[name]).frame((), 1000 + k).image for k in range(FRAMES[name]))


def shaded(model: SensorModel, image: U8, part: float) -> U8:
    """Light that fades towards one side."""
    gain = 1 - part * ramp(1)(model.image_height_px, model.image_width_px) / 255
    gain = gain if image.ndim == 2 else gain[..., None]
    return np.rint(image * gain).astype(np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("name", MODELS)
def test_the_cameras_own_noise_and_other_light_are_no_contact(profile: str, name: str) -> None:
    """Every frame as it is, and in turn with more noise, in other light, in light that fades."""
    model, said = MODELS[name], []
    for seed, image in enumerate(untouched(name)):
        changed = (
            ("noise of 4 levels", camera_faults.noise(image, 4, seed)),
            ("light", camera_faults.gain(image, 0.85 + 0.3 * seed / FRAMES[name])),
            ("fading light", shaded(model, image, 0.3)),
        )[seed % 3]
        for kind, frame in (("its own noise", image), changed):
            result = sound_step(made(profile, name), frame)
            if result.contact or not result.valid:
                said.append(f"{kind} {seed}: {result.reason or result.depth_max_mm}")
    assert not said


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
def test_a_press_in_the_same_noise_is_a_contact(profile: str) -> None:
    """So that a gate that never opens is not called honest."""
    for seed in range(5):
        assert sound_step(
            made(profile, "half"), camera_faults.noise(pressed("ball", 2.0).image, 4, seed)
        ).contact


@pytest.mark.slow
@pytest.mark.parametrize("profile", PROFILES)
def test_no_constant_is_a_contact(profile: str) -> None:
    made = make_reconstructor(built_calibration(96, 128), PROFILES[profile])
    for level in range(256):
        result = sound_step(made, constant(level)(96, 128))
        assert not result.valid
        assert not result.contact
