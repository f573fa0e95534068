from __future__ import annotations

import numpy as np
import pytest
from support.built_sensor import FIELD, PITCH_PX, sparse_dome
from support.calibrated_sensor import FULL, HALF, TACTIP, references

from tacshade_edge.core.calibration.reference.pattern import find_disc, marker_pitch_px
from tacshade_edge.core.calibration.reference.threshold_choice import choose_binarisation
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.simulator.model import SensorModel


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
