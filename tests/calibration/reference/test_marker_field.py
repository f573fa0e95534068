from __future__ import annotations

import cv2
import numpy as np
import pytest

from support.built_sensor import FIELD, PITCH_PX, pins_px, sparse_dome
from support.calibrated_sensor import (
    HALF,
    TACTIP,
    references,
)
from tacshade_edge.calibration.reference.marker_field import choose_binarisation, find_markers
from tacshade_edge.calibration.reference.pattern import (
    marker_pitch_px,
)
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.types import Disc


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


def test_noise_has_no_markers() -> None:
    rng = np.random.default_rng(0)
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


@pytest.mark.parametrize(
    ("noise_grey", "chosen"), [(5.0, "otsu"), (2.5, "otsu"), (0.0, "adaptive")]
)
def test_pins_that_stand_far_apart_are_split_from_the_noise_between_them(
    noise_grey: float, chosen: str
) -> None:
    dome = sparse_dome(noise_grey=noise_grey, contrast_grey=70.0)
    assert choose_binarisation(dome, FIELD, PITCH_PX) == chosen


@pytest.mark.slow
def test_dense_patterns_and_what_has_no_markers_keep_the_mean_around() -> None:
    for model in (HALF, TACTIP):
        grey = to_grey(references(model, 1)[0])
        assert (
            choose_binarisation(
                grey, model.geometry.disc, marker_pitch_px(grey, model.geometry.disc)
            )
            == "adaptive"
        )
    noise = np.random.default_rng(1).integers(0, 256, (240, 320), dtype=np.uint8)
    assert choose_binarisation(noise, FIELD, 9.0) == "adaptive"
