from __future__ import annotations

import numpy as np
import pytest

from tacshade_edge.core.frame_check.torn import tear_check, torn_row
from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.simulator import camera_faults
from tacshade_edge.types import Disc

MASK = disc_mask(100, 120, Disc(50.0, 60.0, 40.0))
# A tear by half a stripe changes every pixel of a row, and nothing else differs from row to row but the noise.
STRIPES = camera_faults.noise(np.tile(np.uint8(60) + np.uint8(120) * (np.arange(120) % 16 < 8), (100, 1)), 2, 1)


@pytest.mark.parametrize("row", [30, 50, 75])
def test_it_names_the_row_above_the_tear(row: int) -> None:
    check = tear_check(STRIPES, MASK)
    assert check
    assert torn_row(camera_faults.torn(STRIPES, STRIPES, row, 8), check) == row - 1


def test_an_untorn_frame_has_none_nor_one_whose_reference_looks_the_same() -> None:
    torn = camera_faults.torn(STRIPES, STRIPES, 50, 8)
    check, torn_check = tear_check(STRIPES, MASK), tear_check(torn, MASK)
    assert check
    assert torn_check
    assert torn_row(camera_faults.noise(STRIPES, 2, 2), check) is None
    assert torn_row(torn, torn_check) is None


def test_an_edge_across_a_part_of_the_disc_is_none() -> None:
    """As of a contact, which may follow a row."""
    check = tear_check(STRIPES, MASK)
    assert check
    image = STRIPES.copy()
    image[50:, 20:60] = 255 - image[50:, 20:60]
    assert torn_row(image, check) is None


def test_few_or_narrow_rows_are_not_looked_at() -> None:
    grey, mask = np.zeros((90, 90), np.uint8), np.zeros((90, 90), bool)
    mask[:, :59] = True
    assert tear_check(grey, mask) is None
    mask[40:47, :60] = True
    assert tear_check(grey, mask) is None
    mask[40:48, :60] = True
    assert tear_check(grey, mask) is not None
