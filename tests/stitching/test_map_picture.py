from __future__ import annotations

import numpy as np

from support.rasters import raster
from tacshade_edge.files.drawing import LEFT_PX, TOP_PX
from tacshade_edge.stitching.map_picture import PREVIEW_PX, preview
from tacshade_edge.stitching.stitcher import Raster


def test_a_preview_has_y_upwards_and_holes_in_grey() -> None:
    picture, zoom = preview(raster(30, 40))[TOP_PX:, LEFT_PX:], PREVIEW_PX // 40
    assert (picture[(30 - 7) * zoom + zoom // 2, 6 * zoom + zoom // 2] == 225).all()
    assert picture[2, 2].astype(int).sum() != picture[30 * zoom - 3, 2].astype(int).sum()
    assert max(preview(raster(3000, 10)).shape) < 1100
    assert preview(Raster(np.full((1, 1), np.nan, np.float32), 0, 0, 0.25)).ndim == 3
