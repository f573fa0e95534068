"""The picture of the paper's Fig. 6."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.calibrated_sensor import calibrated
from support.half_family import HALF_SENSOR, half_family

from tacshade_edge.studies.evaluate import picture


@pytest.mark.slow
def test_every_row_shows_something_and_found_and_true_points_have_two_colours() -> None:
    with half_family():
        made = picture.columns(HALF_SENSOR, calibrated(), "fast", ("cube",))
        assert [column.title for column in made] == ["cube"]
        drawn = cv2.imdecode(np.frombuffer(picture.draw(made, calibrated(), "fast"), np.uint8), cv2.IMREAD_COLOR)
    rows, cols = drawn.shape[:2]
    assert rows > cols > 200
    for row in np.array_split(drawn[int(0.05 * rows) :, int(0.06 * cols) : int(0.94 * cols)], 12):
        assert (row.min(axis=2) < 235).mean() > 0.005
    np.testing.assert_array_equal(drawn[2, 2], 255)
    clouds = drawn[int(0.8 * rows) :].astype(int)
    for colour in (picture.FOUND_COLOUR, picture.TRUE_COLOUR):
        bgr = np.array([int(colour[k : k + 2], 16) for k in (5, 3, 1)])
        assert (np.abs(clouds - bgr).max(axis=2) < 40).sum() > 200
