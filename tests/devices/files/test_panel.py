from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from support.painted_sensor import BLACK, FREE, HEIGHT, TOUCHED, WIDTH, painted_calibration

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.devices.files.panel import panel, write_panel
from tacshade_edge.devices.weights.network import make_reconstructor
from tacshade_edge.types import U8, Frame, Reconstruction


def result_of(image: U8) -> Reconstruction:
    return make_reconstructor(painted_calibration(), PROFILES["fast"]).step(Frame(0, 0, 0, image))


@pytest.mark.parametrize("image", [FREE, TOUCHED, BLACK], ids=["free", "touched", "black"])
@pytest.mark.parametrize("colour", [False, True])
def test_a_picture_of_every_outcome(image: U8, colour: bool) -> None:
    shown = np.dstack([image] * 3) if colour else image
    picture = panel(shown, result_of(image))
    assert picture.dtype == np.uint8
    assert picture.shape[1:] == (2 * WIDTH, 3)
    np.testing.assert_array_equal(picture[:HEIGHT, :WIDTH], np.dstack([image] * 3))
    assert (picture[0, WIDTH] == 255).all()  # outside the disc
    assert (picture[HEIGHT:] < 128).any()  # the legend says something


def test_the_deepest_is_the_brightest() -> None:
    result = result_of(TOUCHED)
    right = panel(TOUCHED, result)[:HEIGHT, WIDTH:].astype(int).sum(axis=2)
    height = result.height
    rows = np.rint((np.arange(HEIGHT) - height.row0) / height.step_px).astype(int).clip(0, height.contact.shape[0] - 1)
    cols = np.rint((np.arange(WIDTH) - height.col0) / height.step_px).astype(int).clip(0, height.contact.shape[1] - 1)
    contact = height.contact[np.ix_(rows, cols)].astype(np.uint8)
    inside = np.hypot(np.arange(HEIGHT)[:, None] - 59.5, np.arange(WIDTH)[None, :] - 79.5) < 45
    assert contact[:, :WIDTH].sum() > 500
    core = cv2.erode(contact, np.ones((9, 9), np.uint8)) > 0
    assert right[core].mean() > right[inside & (contact == 0)].mean() + 50


def test_a_frame_of_another_size_is_shown_with_its_reason(tmp_path: Path) -> None:
    image = np.full((50, 70), 90, np.uint8)
    result = result_of(image)
    assert not result.valid
    write_panel(tmp_path / "p.png", image, result)
    assert cv2.imread(str(tmp_path / "p.png")).shape[1] == 140
