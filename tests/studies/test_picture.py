from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from support.calibrated_sensor import calibrated
from support.half_family import HALF_SENSOR, half_family

from tacshade_edge.studies.evaluate import picture
from tacshade_edge.types import U8


@pytest.fixture(scope="module", autouse=True)
def family() -> Iterator[None]:
    with half_family():
        yield


@pytest.fixture(scope="module")
def drawn() -> U8:
    made = picture.columns(HALF_SENSOR, calibrated(), "fast", ("cube", "ball"))
    assert [c.title for c in made] == ["cube", "ball"]
    return np.asarray(cv2.imdecode(np.frombuffer(picture.draw(made, calibrated(), "fast"), np.uint8), 1), np.uint8)


def ink(image: U8) -> float:
    """How much of it is not white."""
    return float((image.min(axis=2) < 235).mean())


@pytest.mark.slow
def test_every_row_and_column_shows_something(drawn: U8) -> None:
    rows, cols = drawn.shape[:2]
    assert rows > cols > 500
    for column in np.array_split(drawn[:, int(0.06 * cols) : int(0.94 * cols)], 2, axis=1):
        for row in np.array_split(column[int(0.05 * rows) :], 12):
            assert ink(row) > 0.005
    np.testing.assert_array_equal(drawn[2, 2], 255)


@pytest.mark.slow
def test_found_and_true_points_have_two_colours(drawn: U8) -> None:
    clouds = drawn[int(0.8 * len(drawn)) :].astype(int)
    for colour in (picture.FOUND_COLOUR, picture.TRUE_COLOUR):
        bgr = np.array([int(colour[k : k + 2], 16) for k in (5, 3, 1)])
        assert (np.abs(clouds - bgr).max(axis=2) < 40).sum() > 200
