from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.calibrated_sensor import FULL, simulated, unloaded

from tacshade_edge.core.calibration.reference.view import Pattern, find_pattern, view
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import U8, Disc


@pytest.fixture(scope="module")
def grey() -> U8:
    return to_grey(unloaded(FULL))


@pytest.fixture(scope="module")
def pattern(grey: U8) -> Pattern:
    return find_pattern(grey)


def test_the_disc_is_that_of_the_whole_image(pattern: Pattern) -> None:
    disc = simulated(FULL).model.geometry.disc
    found = (pattern.disc.row_c, pattern.disc.col_c, pattern.disc.radius_px)
    assert found == pytest.approx((disc.row_c, disc.col_c, disc.radius_px), abs=1.5)


def test_a_blurred_picture_has_less_focus_and_a_dark_one_less_contrast(grey: U8, pattern: Pattern) -> None:
    sharp = view(grey, pattern)
    assert sharp.advice == ""
    blurred = [view(cv2.GaussianBlur(grey, (0, 0), sigma), pattern).focus for sigma in (1.0, 2.0, 3.0)]
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


def test_a_disc_outside_of_the_image_shows_nothing(grey: U8) -> None:
    assert view(grey, Pattern(Disc(-900.0, 0.0, 10.0), 5.0)).focus == 0.0
