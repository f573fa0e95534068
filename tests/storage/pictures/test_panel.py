from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.storage.pictures.axes import BAR_PX, BOTTOM_PX, LEFT_PX, RIGHT_PX, TOP_PX, Axis, ticks
from tacshade_edge.storage.pictures.panel import panel, write_panel
from tacshade_edge.types import U8, Frame, Reconstruction
from tools.testbed.painted_sensor import BLACK, FREE, HEIGHT, TOUCHED, WIDTH, painted_calibration

GEOMETRY = painted_calibration().geometry


def result_of(image: U8) -> Reconstruction:
    return make_reconstructor(painted_calibration(), PROFILES["fast"]).step(Frame(0, 0, 0, image))


@pytest.mark.parametrize("image", [FREE, TOUCHED, BLACK], ids=["free", "touched", "black"])
@pytest.mark.parametrize("colour", [False, True])
def test_a_picture_of_every_outcome(image: U8, colour: bool) -> None:
    shown = np.dstack([image] * 3) if colour else image
    picture = panel(shown, result_of(image), GEOMETRY)
    assert picture.dtype == np.uint8
    width = LEFT_PX + WIDTH + RIGHT_PX
    assert picture.shape[1:] == (2 * width + BAR_PX, 3)
    at = slice(TOP_PX, TOP_PX + HEIGHT), slice(LEFT_PX, LEFT_PX + WIDTH)
    np.testing.assert_array_equal(picture[at], np.dstack([image] * 3))
    assert (picture[TOP_PX, width + LEFT_PX] == 255).all()  # outside the disc
    assert (picture[TOP_PX + HEIGHT + BOTTOM_PX :] < 128).any()  # the legend says something
    # Each side has its scale in ink: rows and mm at the left, columns and mm below, the bar's mm at the right.
    for area in (picture[at[0], :LEFT_PX], picture[at[0], width : width + LEFT_PX], picture[at[0], -BAR_PX + 20 :]):
        assert (area < 128).any()
    below = picture[TOP_PX + HEIGHT + 6 : TOP_PX + HEIGHT + BOTTOM_PX]
    assert (below[:, :width] < 128).any()
    assert (below[:, width : 2 * width] < 128).any()


def test_the_axis_is_round_millimetres_from_the_discs_centre() -> None:
    mm = GEOMETRY.mm_per_px
    found = ticks(Axis("x (mm)", -GEOMETRY.disc.col_c * mm, mm), WIDTH)
    assert [value for value, _ in found] == [-20, 0, 20]
    assert dict(found)[0] == pytest.approx(GEOMETRY.disc.col_c)
    assert dict(found)[20] == pytest.approx(GEOMETRY.disc.col_c + 20 / mm)


def test_the_deepest_is_the_brightest() -> None:
    result = result_of(TOUCHED)
    right = panel(TOUCHED, result, GEOMETRY)[TOP_PX:, LEFT_PX + WIDTH + RIGHT_PX + LEFT_PX :]
    right = right[:HEIGHT, :WIDTH].astype(int).sum(axis=2)
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
    write_panel(tmp_path / "p.png", image, result, GEOMETRY)
    assert cv2.imread(str(tmp_path / "p.png")).shape[1] == 2 * (LEFT_PX + 70 + RIGHT_PX) + BAR_PX
