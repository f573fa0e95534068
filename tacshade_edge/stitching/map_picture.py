"""A stitched map seen from above, for people."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from tacshade_edge.files.drawing import Axis, colours, framed, with_legend
from tacshade_edge.stitching.stitcher import Raster
from tacshade_edge.types import F32, U8

PREVIEW_PX = 900
"""Greatest length of the map's longer side."""
_UNTOUCHED_GREY: Final = 225


def preview(raster: Raster) -> U8:
    """A stitched map seen from above, y upwards: heights in colours,
    grey where nothing was touched; axes in mm.
    """
    low, high = height_span_mm(raster.z_mm)
    rows, cols = raster.z_mm.shape
    # A subset of cells is enough for a large map.
    stride = max(1, max(rows, cols) // (2 * PREVIEW_PX))
    z = raster.z_mm[::stride, ::stride]
    picture = colours(z, low, max(high, low + 0.1), _UNTOUCHED_GREY)
    if max(z.shape) > PREVIEW_PX:
        size = tuple(max(1, round(s * PREVIEW_PX / max(z.shape))) for s in z.shape[::-1])
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    zoom = max(1, PREVIEW_PX // max(z.shape))
    picture = np.flipud(picture).repeat(zoom, axis=0).repeat(zoom, axis=1)
    down_mm, along_mm = (
        n * raster.step_mm / px for n, px in zip((rows, cols), picture.shape[:2], strict=True)
    )
    x = Axis("x (mm)", raster.x0_mm + (along_mm - raster.step_mm) / 2, along_mm)
    y = Axis("y (mm)", raster.y0_mm + (rows - 0.5) * raster.step_mm - down_mm / 2, -down_mm)
    size_mm = f"{cols * raster.step_mm:.0f} x {rows * raster.step_mm:.0f} mm"
    text = (
        f"{size_mm}, colours {low:.2f} to {high:.2f} mm"
        if low < high
        else f"{size_mm}, nothing touched"
    )
    return with_legend(framed(picture, x, y), text)


def height_span_mm(z_mm: F32) -> tuple[float, float]:
    """The least and the greatest height in mm; zeros if nothing was touched."""
    low, high = float(np.fmin.reduce(z_mm, axis=None)), float(np.fmax.reduce(z_mm, axis=None))
    return (low, high) if math.isfinite(low) else (0.0, 0.0)
