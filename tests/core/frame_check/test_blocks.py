from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from support.calibrated_sensor import FULL, HALF, TACTIP, calibrated, pressed, random_sensor, unloaded
from support.plain_blocks import plain_blocks

from tacshade_edge.core.frame_check.blocks import ROUNDED, block_check, block_means, block_reasons
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.simulator import camera_faults
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.types import U8


@given(grey=hnp.arrays(np.uint8, (16, 24)), rounded=st.integers(0, ROUNDED))
def test_rounded_blocks_err_by_no_more_than_is_said(grey: U8, rounded: int) -> None:
    mean, variance = block_means(grey, rounded)
    plain_mean, plain_std = plain_blocks(grey)
    assert np.abs(mean - plain_mean).max() <= rounded / 2
    assert (np.sqrt(np.maximum(variance, 0)) <= plain_std + rounded / 2 + 0.1).all()
    if rounded == 0:
        assert np.abs(variance - plain_std**2).max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("model", [HALF, FULL, TACTIP, random_sensor(0)], ids=["half", "full", "tactip", "r0"])
def test_a_good_frame_needs_no_second_look(model: SensorModel) -> None:
    """What makes the check fast: the rounded blocks of good frames already tell that they are good."""
    calibration = calibrated(model, 0)
    check = block_check(calibration.reference_grey, calibration.geometry.disc)
    assert check
    for image in (unloaded(model), pressed("ball", 3.0, model).image, camera_faults.gain(unloaded(model), 0.8)):
        assert block_reasons(to_grey(image), check, ROUNDED) == (None, None)


@given(factor=st.floats(0.3, 2.4), rows=st.integers(-9, 9), sigma=st.floats(0, 12))
def test_the_first_look_misses_nothing(factor: float, rows: int, sigma: float) -> None:
    calibration = calibrated(HALF, 0)
    check = block_check(calibration.reference_grey, calibration.geometry.disc)
    assert check
    image = camera_faults.noise(camera_faults.shift(camera_faults.gain(unloaded(HALF), factor), rows, 0), sigma, 1)
    first, exact = (block_reasons(to_grey(image), check, rounded) for rounded in (ROUNDED, 0))
    assert all(coarse for coarse, said in zip(first, exact, strict=True) if said)
