from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.calibrated_sensor import HALF, simulated

from tacshade_edge.core.calibration.reference.references import block_means, motion_grey, stands_still
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.simulator.press import Press, ball
from tacshade_edge.types import F32


def blocks(depths_mm: list[float], seed: int) -> list[F32]:
    presses = [(Press(ball(4.0), 5.0, 2.0, depth_mm),) if depth_mm else () for depth_mm in depths_mm]
    return [block_means(to_grey(simulated(HALF).frame(press, seed + k).image)) for k, press in enumerate(presses)]


@pytest.mark.slow
def test_a_held_press_stands_still_and_a_moved_one_does_not() -> None:
    rest = motion_grey(blocks([0.0] * 10, 0))
    assert stands_still(motion_grey(blocks([2.0] * 10, 100)), rest)
    assert not stands_still(motion_grey(blocks([2.0] * 5 + [2.1] * 5, 200)), rest)


def test_one_image_stands_still() -> None:
    assert motion_grey(blocks([0.0], 0)) == 0.0


@given(level=st.integers(0, 40), shape=st.tuples(st.integers(8, 50), st.integers(8, 50)))
def test_a_light_that_flickers_moves_nothing(level: int, shape: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 200, shape).astype(np.uint8)
    first, second = block_means(image), block_means(image + np.uint8(level))
    assert first.shape == (shape[0] // 8, shape[1] // 8)
    assert motion_grey([first, second]) == pytest.approx(0.0, abs=1e-3)
