import math

import numpy as np
import pytest

from tools.testbed.simulator import camera_faults

IMAGE = np.arange(48 * 64 * 3, dtype=np.uint32).reshape(48, 64, 3).astype(np.uint8)


@pytest.mark.parametrize("image", [IMAGE, IMAGE[..., 0]])
def test_glare_is_brightest_at_its_place_and_local(image: np.ndarray) -> None:
    added = camera_faults.glare(image, 20, 30, 3.0).astype(int) - image
    assert added.min() >= 0
    assert added[20, 30].max() == (np.minimum(image[20, 30].astype(int) + 220, 255) - image[20, 30]).max()
    assert not added[:, 55:].any()


def test_torn_keeps_the_top_and_takes_the_bottom_sideways() -> None:
    other = 255 - IMAGE
    result = camera_faults.torn(IMAGE, other, 20, 5)
    assert np.array_equal(result[:20], IMAGE[:20])
    assert np.array_equal(result[20:, 5:], other[20:, :-5])


def test_defocus_keeps_the_mean_and_lowers_the_contrast() -> None:
    board = (np.indices((40, 40)).sum(axis=0) % 2 * 200).astype(np.uint8)
    result = camera_faults.defocus(board, 3.0)
    assert result.mean() == pytest.approx(100, abs=1)
    assert result.std() < 2


def test_noise_has_its_deviation_and_its_seed() -> None:
    grey = np.full((200, 200), 128, np.uint8)
    result = camera_faults.noise(grey, 10.0, 1)
    assert result.std() == pytest.approx(10.0, rel=0.03)
    assert result.mean() == pytest.approx(128, abs=0.2)
    assert np.array_equal(result, camera_faults.noise(grey, 10.0, 1))
    assert not np.array_equal(result, camera_faults.noise(grey, 10.0, 2))


def test_uneven_light_dims_one_side_alone() -> None:
    result = camera_faults.uneven(np.full((41, 41), 200, np.uint8), 20, 20, 20, 0.5, 0.0)
    assert result[20, [0, 20, 40]].tolist() == [200, 150, 100]
    assert (result == result[0]).all()


def test_warming_up_lifts_black_dims_white_and_enlarges() -> None:
    board = np.where(np.arange(200) < 180, np.uint8(0), np.uint8(200)) * np.ones((9, 1), np.uint8)
    np.testing.assert_array_equal(camera_faults.warm(board, 4, 0, 0.0), board)
    result = camera_faults.warm(board, 4, 0, 1.0)
    assert result[4, 0] == 6
    assert result[4, -1] == 190
    assert 6 < result[4, 180] < 190  # the edge at 179.5 moved to 180.04


def test_a_speck_is_dark_round_and_local() -> None:
    image = np.full((60, 80), 200, np.uint8)
    dusty = camera_faults.speck(image, 30.0, 40.0, 5.0)
    changed = dusty != image
    assert dusty[30, 40] == 20
    assert np.count_nonzero(changed) == pytest.approx(math.pi * 25, rel=0.3)
    assert not changed[:23].any()
    assert not changed[:, 48:].any()
