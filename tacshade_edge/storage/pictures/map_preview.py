"""A stitched map as a picture for people, with axes."""

from __future__ import annotations

import math

import cv2
import numpy as np

from tacshade_edge.core.stitching.surface_map import Raster
from tacshade_edge.types import F32, U8

PREVIEW_PX = 900  # greatest length of the map's longer side
_LEGEND_PX = 24
_AXIS_PX = 24
MARGIN_PX = 48  # left of the map, for the numbers of y
_TICK_PX = 6
_TICKS = 5  # approximate number along the longer side
_UNTOUCHED_GREY = 225


def preview(raster: Raster) -> U8:
    """The map seen from above, y upwards: heights in colours, grey where nothing was touched; x and y in mm."""
    low, high = height_span_mm(raster.z_mm)
    rows, cols = raster.z_mm.shape
    stride = max(1, max(rows, cols) // (2 * PREVIEW_PX))  # a subset of cells is enough for a large map
    z = raster.z_mm[::stride, ::stride]
    level = np.nan_to_num(np.clip((z - low) / max(high - low, 0.1) * 255, 0, 255)).astype(np.uint8)
    picture = np.asarray(cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS), np.uint8)
    picture[~np.isfinite(z)] = _UNTOUCHED_GREY
    if max(z.shape) > PREVIEW_PX:
        size = tuple(max(1, round(s * PREVIEW_PX / max(z.shape))) for s in z.shape[::-1])
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    zoom = max(1, PREVIEW_PX // max(z.shape))
    picture = np.flipud(picture).repeat(zoom, axis=0).repeat(zoom, axis=1)
    height_px, width_px = picture.shape[:2]
    framed = np.full((height_px + _AXIS_PX + _LEGEND_PX, MARGIN_PX + width_px, 3), 255, np.uint8)
    framed[:height_px, MARGIN_PX:] = picture
    _draw_axes(framed, raster, height_px, width_px)
    size_mm = f"{cols * raster.step_mm:.0f} x {rows * raster.step_mm:.0f} mm"
    text = f"x right, y up, mm; {size_mm}, colours {low:.2f} to {high:.2f} mm" if low < high else "nothing touched"
    _write(framed, text, 6, len(framed) - 8)
    return framed


def tick_step_mm(span_mm: float) -> float:
    """A step in mm of 1, 2 or 5 times a power of ten, about a fifth of the span."""
    raw_mm = span_mm / _TICKS
    decade_mm = 10.0 ** math.floor(math.log10(raw_mm) + 1e-9)
    return decade_mm * next(factor for factor in (1, 2, 5, 10) if raw_mm <= factor * decade_mm * (1 + 1e-9))


def height_span_mm(z_mm: F32) -> tuple[float, float]:
    """The least and the greatest height in mm; zeros if nothing was touched."""
    low, high = float(np.fmin.reduce(z_mm, axis=None)), float(np.fmax.reduce(z_mm, axis=None))
    return (low, high) if math.isfinite(low) else (0.0, 0.0)


def _draw_axes(framed: U8, raster: Raster, height_px: int, width_px: int) -> None:
    """Draw ticks with numbers below the picture and on its left; a cell's position is its middle."""
    rows, cols = raster.z_mm.shape
    step_mm = tick_step_mm(max(rows, cols) * raster.step_mm)
    decimals = max(0, -math.floor(math.log10(step_mm) + 1e-9))
    for x_mm in _ticks_mm(raster.x0_mm, cols, raster.step_mm, step_mm):
        at = MARGIN_PX + int(((x_mm - raster.x0_mm) / raster.step_mm + 0.5) * width_px / cols)
        framed[height_px : height_px + _TICK_PX, at] = 0
        _write(framed, f"{x_mm:.{decimals}f}", max(at - 12, MARGIN_PX), height_px + 20)
    for y_mm in _ticks_mm(raster.y0_mm, rows, raster.step_mm, step_mm):
        at = int((rows - 0.5 - (y_mm - raster.y0_mm) / raster.step_mm) * height_px / rows)
        framed[at, MARGIN_PX - _TICK_PX : MARGIN_PX] = 0
        _write(framed, f"{y_mm:.{decimals}f}", 2, max(at + 4, 10))


def _ticks_mm(first_mm: float, cells: int, cell_mm: float, step_mm: float) -> list[float]:
    last_mm = first_mm + (cells - 1) * cell_mm
    numbers = range(math.ceil(first_mm / step_mm - 1e-6), math.floor(last_mm / step_mm + 1e-6) + 1)
    return [number * step_mm for number in numbers]


def _write(framed: U8, text: str, col: int, row: int) -> None:
    cv2.putText(framed, text, (col, row), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
