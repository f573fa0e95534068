from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.published_sensor import unmeasured

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.stitching.stitcher import Raster
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.storage.pictures import (
    BAR_WIDTH_PX,
    LEFT_PX,
    PREVIEW_PX,
    RIGHT_PX,
    SHEET_COLUMNS,
    TILE_PX,
    TOP_PX,
    contact_sheet,
    preview,
    tile,
)
from tacshade_edge.types import U8, Frame, Reconstruction
from tools.testbed.painted_sensor import BLACK, FREE, TOUCHED, painted_calibration


def result_of(image: U8) -> Reconstruction:
    return make_reconstructor(painted_calibration(), PROFILES["fast"]).step(Frame(0, 0, 0, image))


@pytest.mark.slow
def test_a_contact_sheet_has_every_map_in_the_same_colours() -> None:
    images = [FREE, TOUCHED, BLACK, np.dstack([TOUCHED] * 3), FREE]
    tiles = [tile(f"{k}", image, result_of(image)) for k, image in enumerate(images)]
    free, touched, *others = (each.text.partition(": ")[2] for each in tiles)
    assert (free, others) == ("no contact", ["black", touched, "no contact"])
    assert touched.endswith(" mm")
    sheet = contact_sheet(tiles)
    bar_px = LEFT_PX + BAR_WIDTH_PX + RIGHT_PX
    high, wide = (sheet.shape[0] // 2, (sheet.shape[1] - bar_px) // SHEET_COLUMNS)
    maps = [
        sheet[(k // SHEET_COLUMNS) * high :][:high, (k % SHEET_COLUMNS) * wide + TILE_PX :][
            :, :TILE_PX
        ]
        for k in range(5)
    ]
    np.testing.assert_array_equal(maps[1][: high // 2], maps[3][: high // 2])
    deep = [
        ((map_[..., 2] > 200) & (map_[..., 0] < 100)).any() for map_ in maps
    ]  # the scale's yellow end
    assert deep == [False, True, False, True, False]


def test_a_touch_of_unknown_depth_is_named_on_the_sheet() -> None:
    lost = unmeasured(1)
    image = np.zeros((480, 640), np.uint8)
    assert tile("one", image, lost).text == "one: touched, depth unknown"
    assert tile("one", image, replace(lost, touched=False)).text == "one: no contact"


def raster(rows: int, cols: int) -> Raster:
    """Heights that grow downwards, with a hole at (6, 6);
    0.25 mm a cell, from x 10 and y -20 mm.
    """
    z = np.linspace(-1, 1, rows * cols, dtype=np.float32).reshape(rows, cols)
    z[5:8, 5:8] = np.nan
    return Raster(z, 10.0, -20.0, 0.25)


def test_a_preview_has_y_upwards_and_holes_in_grey() -> None:
    picture, zoom = preview(raster(30, 40))[TOP_PX:, LEFT_PX:], PREVIEW_PX // 40
    assert (picture[(30 - 7) * zoom + zoom // 2, 6 * zoom + zoom // 2] == 225).all()
    assert picture[2, 2].astype(int).sum() != picture[30 * zoom - 3, 2].astype(int).sum()
    assert max(preview(raster(3000, 10)).shape) < 1100
    assert preview(Raster(np.full((1, 1), np.nan, np.float32), 0, 0, 0.25)).ndim == 3
