from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.painted_sensor import BLACK, DISC, FREE, TOUCHED, painted_calibration
from support.published_sensor import unmeasured
from tacshade_edge.files.drawing import (
    BAR_WIDTH_PX,
    LEFT_PX,
    RIGHT_PX,
    SHEET_COLUMNS,
    TILE_PX,
    contact_sheet,
    tile,
)
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import U8, Disc, Frame, Reconstruction


def result_of(image: U8) -> Reconstruction:
    return make_reconstructor(painted_calibration(), PROFILES["fast"]).step(Frame(0, 0, 0, image))


@pytest.mark.slow
def test_a_contact_sheet_has_every_map_in_the_same_colours() -> None:
    images = [FREE, TOUCHED, BLACK, np.dstack([TOUCHED] * 3), FREE]
    tiles = [tile(f"{k}", image, result_of(image), DISC) for k, image in enumerate(images)]
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
    assert tile("one", image, lost, DISC).text == "one: touched, depth unknown"
    assert tile("one", image, replace(lost, touched=False), DISC).text == "one: no contact"


def test_a_tile_shows_the_disc_alone() -> None:
    image = np.zeros((480, 640), np.uint8)
    image[:, :320] = 255
    shown = tile("one", image, unmeasured(1), Disc(row_c=240, col_c=320, radius_px=100))
    assert shown.thumbnail.shape[:2] == (TILE_PX, TILE_PX)
    assert 0.49 < (shown.thumbnail > 127).mean() < 0.51
    assert shown.part == (slice(137, 344), slice(217, 424))


@pytest.mark.parametrize("shape", [(1, 640), (40, 640), (480, 640), (640, 40)])
@pytest.mark.parametrize("count", [1, 5])
def test_a_sheet_of_pictures_of_any_shape_has_a_bar(shape: tuple[int, int], count: int) -> None:
    one = tile("one", np.zeros(shape, np.uint8), unmeasured(1), DISC)
    assert contact_sheet([one] * count).shape[0] >= LEFT_PX
