import numpy as np
import pytest

from tacshade_edge.simulator import camera_faults

IMAGE = np.arange(48 * 64 * 3, dtype=np.uint32).reshape(48, 64, 3).astype(np.uint8)


def test_gain_scales_and_clips() -> None:
    assert np.array_equal(camera_faults.gain(IMAGE, 1.0), IMAGE)
    assert camera_faults.gain(np.full((2, 2), 100, np.uint8), 0.9).tolist() == [[90, 90], [90, 90]]
    assert camera_faults.gain(np.full((2, 2), 250, np.uint8), 1.1).max() == 255


@pytest.mark.parametrize(("rows", "cols"), [(1, 0), (-2, 3), (0, 0)])
def test_shift_moves_by_whole_pixels(rows: int, cols: int) -> None:
    result = camera_faults.shift(IMAGE, rows, cols)
    assert np.array_equal(result[10 + rows, 10 + cols], IMAGE[10, 10])
    assert result.shape == IMAGE.shape
