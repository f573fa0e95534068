from __future__ import annotations

import numpy as np
import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.stitching.stitcher import Raster
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.storage.pictures import (
    BAR_PX,
    BOTTOM_PX,
    LEFT_PX,
    PREVIEW_PX,
    RIGHT_PX,
    SHEET_COLUMNS,
    TILE_PX,
    TOP_PX,
    contact_sheet,
    panel,
    preview,
    tile,
)
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


def test_a_contact_sheet_has_every_map_in_the_same_colours() -> None:
    images = [FREE, TOUCHED, BLACK, np.dstack([TOUCHED] * 3), FREE]
    tiles = [tile(f"{k}", image, result_of(image)) for k, image in enumerate(images)]
    free, touched, *others = (each.text.partition(": ")[2] for each in tiles)
    assert (free, others) == ("no contact", ["black", touched, "no contact"])
    assert touched.endswith(" mm")
    sheet = contact_sheet(tiles)
    high, wide = (sheet.shape[0] // 2, (sheet.shape[1] - BAR_PX) // SHEET_COLUMNS)
    maps = [
        sheet[(k // SHEET_COLUMNS) * high :][:high, (k % SHEET_COLUMNS) * wide + TILE_PX :][:, :TILE_PX]
        for k in range(5)
    ]
    np.testing.assert_array_equal(maps[1][: high // 2], maps[3][: high // 2])
    deep = [((map_[..., 2] > 200) & (map_[..., 0] < 100)).any() for map_ in maps]  # the scale's yellow end
    assert deep == [False, True, False, True, False]


def raster(rows: int, cols: int) -> Raster:
    """Heights that grow downwards, with a hole at (6, 6); 0.25 mm a cell, from x 10 and y -20 mm."""
    z = np.linspace(-1, 1, rows * cols, dtype=np.float32).reshape(rows, cols)
    z[5:8, 5:8] = np.nan
    return Raster(z, 10.0, -20.0, 0.25)


def test_a_preview_has_y_upwards_and_holes_in_grey() -> None:
    picture, zoom = preview(raster(30, 40))[TOP_PX:, LEFT_PX:], PREVIEW_PX // 40
    assert (picture[(30 - 7) * zoom + zoom // 2, 6 * zoom + zoom // 2] == 225).all()
    assert picture[2, 2].astype(int).sum() != picture[30 * zoom - 3, 2].astype(int).sum()
    assert max(preview(raster(3000, 10)).shape) < 1100
    assert preview(Raster(np.full((1, 1), np.nan, np.float32), 0, 0, 0.25)).ndim == 3
