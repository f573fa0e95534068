from __future__ import annotations

import cv2
import numpy as np
import pytest
from support.built_sensor import FIELD, PITCH_PX, SIZE, pins_px, sparse_dome

from tacshade_edge.core.calibration.reference.marker_field import find_markers
from tacshade_edge.core.calibration.reference.pattern import find_disc, marker_pitch_px
from tacshade_edge.types import U8, Disc


@pytest.mark.parametrize("size", [1.0, 0.25, 0.21])
def test_each_pin_is_found_and_no_lamp_is_one(size: float) -> None:
    """Of pictures from 100 px on."""
    image = cv2.resize(sparse_dome(), None, fx=size, fy=size, interpolation=cv2.INTER_AREA)
    found = find_markers(image)
    assert found is not None
    true = (pins_px() + 0.5) * size - 0.5
    nearest = np.linalg.norm(found.markers_px[:, None] - true[None], axis=2).min(axis=1)
    assert len(found.markers_px) >= 0.97 * len(true)
    assert nearest.max() < max(0.15 * PITCH_PX * size, 1.0)
    assert found.pitch_px == pytest.approx(PITCH_PX * size, rel=0.06)


def test_the_circle_is_where_the_pins_end_not_where_the_lamps_do() -> None:
    disc = find_disc(sparse_dome())
    assert np.hypot(disc.row_c - FIELD.row_c, disc.col_c - FIELD.col_c) < 2
    assert disc.radius_px == pytest.approx(FIELD.radius_px, rel=0.06)


def test_a_thresholded_picture_and_a_small_one_have_a_pitch() -> None:
    rows, cols = np.ogrid[: SIZE[0], : SIZE[1]]
    near = np.hypot(rows - FIELD.row_c, cols - FIELD.col_c) < 180
    black_and_white: U8 = np.where(near & (sparse_dome() > 60), np.uint8(255), np.uint8(0))
    small = cv2.resize(black_and_white[72:432, 132:492], (100, 100), interpolation=cv2.INTER_AREA)
    for image, scale in ((black_and_white, 1.0), (small, 100 / 360)):
        disc = find_disc(image)
        assert disc.radius_px == pytest.approx(FIELD.radius_px * scale, rel=0.07)
        assert marker_pitch_px(image, disc) == pytest.approx(PITCH_PX * scale, rel=0.15)


@pytest.mark.parametrize("seed", range(3))
def test_noise_has_no_markers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert find_markers(rng.integers(0, 256, (240, 320), dtype=np.uint8)) is None
    assert find_markers(np.zeros((12, 12), np.uint8)) is None
    soft = cv2.GaussianBlur(rng.normal(100, 60, (480, 640)).astype(np.float32), (0, 0), 4)
    assert find_markers(np.clip(soft, 0, 255).astype(np.uint8)) is None


def test_what_the_markers_fill() -> None:
    image = sparse_dome()
    found = find_markers(image)
    assert found is not None
    assert found.holds(FIELD)
    assert not found.holds(Disc(FIELD.row_c, FIELD.col_c, 0.8 * FIELD.radius_px))
    assert found.filled_part(FIELD, image.shape) > 0.9
    assert found.filled_part(Disc(FIELD.row_c, FIELD.col_c, 283.0), image.shape) < 0.5
    assert found.filled_part(Disc(-500.0, -500.0, 50.0), image.shape) == 0.0
