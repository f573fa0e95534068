from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.calibrated_sensor import HALF, calibrated, pressed, unloaded

from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.core.image.glare import GLARE_LIFT, GLARE_PX, glare_check, glare_mask
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.simulator import camera_faults
from tacshade_edge.types import U8


def masks() -> tuple[U8, U8]:
    calibration = calibrated(HALF, 0)
    mask = disc_mask(240, 320, calibration.geometry.disc).astype(np.uint8)
    return calibration.reference_grey, mask


@pytest.mark.parametrize("depth_mm", [1.0, 3.0])
@pytest.mark.parametrize("name", ["ball", "cube", "edge"])
def test_a_contact_is_no_glare(name: str, depth_mm: float) -> None:
    reference, mask = masks()
    check = glare_check(reference, mask, calibrated(HALF, 0).pitch_px)
    assert glare_mask(to_grey(pressed(name, depth_mm).image), check) is None


@pytest.mark.parametrize("radius_px", [4, 8, 12])
def test_glare_is_covered_and_the_rest_is_not(radius_px: float) -> None:
    reference, mask = masks()
    check = glare_check(reference, mask, calibrated(HALF, 0).pitch_px)
    assert glare_mask(to_grey(unloaded()), check) is None
    found = glare_mask(to_grey(camera_faults.glare(unloaded(), 110, 190, radius_px)), check)
    assert found is not None
    rows, cols = np.indices(found.shape)
    apart = np.hypot(rows - 110, cols - 190)
    assert found[apart < radius_px].all()
    assert not found[(apart > 3 * radius_px + 4 * calibrated(HALF, 0).pitch_px) & (mask > 0)].any()


@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 20), st.integers(0, 2**32 - 1))
def test_the_glare_search_by_blocks_is_that_by_pixels(rows: int, cols: int, pitch: int, seed: int) -> None:
    """Against plain loops over blocks: the darkest pixel around each, the reference's, the lift."""
    rng = np.random.default_rng(seed)
    reference, grey = (rng.integers(0, 256, (rows, cols), dtype=np.uint8) // 3 for _ in range(2))
    check = glare_check(reference, np.ones_like(grey), float(pitch))
    side, reach = check.block_px, len(check.box) // 2

    def darkest(image: U8, i: int, j: int) -> int:
        top, left = max(side * (i - reach), 0), max(side * (j - reach), 0)
        return int(image[top : side * (i + reach + 1), left : side * (j + reach + 1)].min())

    lifted = [
        (i, j)
        for i in range(-(-rows // side))
        for j in range(-(-cols // side))
        if darkest(grey, i, j) > min(darkest(reference, i, j) + GLARE_LIFT, 255)
    ]
    found = glare_mask(grey, check)
    bright = grey > np.minimum(check.brightest, 255)
    if lifted:
        assert found is not None
        assert all(found[side * i, side * j] for i, j in lifted)
    elif np.count_nonzero(bright) < GLARE_PX:
        assert found is None
