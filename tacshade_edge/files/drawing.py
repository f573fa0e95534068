"""Pictures for people, with axes and colours, drawn without a plotting library,
which boards lack.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.quoting import counted, encodable
from tacshade_edge.reasons import code_of, text_of
from tacshade_edge.types import F32, U8, Calibration, Disc, Geometry, HeightMap, Reconstruction

LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 44, 14, 20, 36
BAR_WIDTH_PX = 12
TILE_PX, SHEET_COLUMNS, SHEET_TILES = 200, 4, 60
# Beside the disc, of its radius: its edge shows whether the circle is right.
_AROUND_DISC = 1.03
# Up to this size a small reference is enlarged: its markers are a few pixels wide.
SEEN_PX = 900
_FOUND, _OUTLINE, _PLACE = (0, 230, 255), (90, 200, 90), (255, 120, 255)
_BAR_AT_PX, _BAR_PITCHES = 8, 5
_HALF_WHITE = 127
_DIMENSIONS_BGR = 3
_FONT, _SCALE, _TICK_PX = cv2.FONT_HERSHEY_SIMPLEX, 0.38, 4
# The least distance between ticks, at which long numbers stay apart.
_LABEL_EVERY_PX = 46
_LEGEND_PX = 22
_BAR_LEAST_PX, _BAR_MOST_PX = 60, 300
_BLACK, _WHITE = (0, 0, 0), (255, 255, 255)
_COLOURS = cv2.COLORMAP_VIRIDIS


@dataclass(frozen=True, slots=True)
class Axis:
    """One side of a picture: its label (ASCII, with the unit), the value at the middle of pixel 0,
    and the increase.
    """

    label: str
    first: float = 0.0
    per_px: float = 1.0


def ticks(axis: Axis, length_px: int) -> list[tuple[float, float]]:
    """Round values along an axis, each with its position in px."""
    least = _LABEL_EVERY_PX * abs(axis.per_px)
    power = 10.0 ** math.floor(math.log10(least))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least)
    low, high = sorted((axis.first, axis.first + (length_px - 1) * axis.per_px))
    values = [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
    return [(value, (value - axis.first) / axis.per_px) for value in values]


def framed(picture: U8, x: Axis | None, y: Axis, title: str = "") -> U8:
    """The picture, uint8 (H, W, 3) BGR, on white with its axes;
    its corner is at row `TOP_PX`, column `LEFT_PX`.
    """
    rows, cols = picture.shape[:2]
    paper = np.full((TOP_PX + rows + BOTTOM_PX, LEFT_PX + cols + RIGHT_PX, 3), 255, np.uint8)
    paper[TOP_PX : TOP_PX + rows, LEFT_PX : LEFT_PX + cols] = picture
    cv2.rectangle(paper, (LEFT_PX - 1, TOP_PX - 1), (LEFT_PX + cols, TOP_PX + rows), _BLACK, 1)
    for value, at_px in ticks(x, cols) if x else ():
        place = LEFT_PX + round(at_px), TOP_PX + rows
        cv2.line(paper, place, (place[0], place[1] + _TICK_PX), _BLACK, 1)
        text = f"{value:g}"
        _write(paper, text, place[0] - _width_px(text) // 2, place[1] + _TICK_PX + 12)
    if x:
        _write(
            paper,
            x.label,
            LEFT_PX + (cols - _width_px(x.label)) // 2,
            TOP_PX + rows + BOTTOM_PX - 5,
        )
    for value, at_px in ticks(y, rows):
        row, text = TOP_PX + round(at_px), f"{value:g}"
        cv2.line(paper, (LEFT_PX - 1, row), (LEFT_PX - 1 - _TICK_PX, row), _BLACK, 1)
        _write(paper, text, LEFT_PX - 3 - _TICK_PX - _width_px(text), row + 4)
    _write(paper, y.label, 4, TOP_PX - 7)
    _write(paper, title, LEFT_PX + (cols - _width_px(title)) // 2, TOP_PX - 7)
    return paper


def colour_bar(height_px: int, top: float, label: str) -> U8:
    """A bar of the colours from 0 to `top`, as high as a picture of `height_px` rows
    after `framed`.
    """
    levels = np.linspace(255, 0, height_px).astype(np.uint8)[:, None].repeat(BAR_WIDTH_PX, axis=1)
    bar = np.asarray(cv2.applyColorMap(levels, _COLOURS), np.uint8)
    return framed(bar, None, Axis(label, top, -top / max(height_px - 1, 1)))


def write_picture(path: Path, picture: U8) -> None:
    """Write a picture, uint8 BGR, as PNG."""
    path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())


def _without_depth(result: Reconstruction) -> str:
    """What a valid frame without a contact shows."""
    return "touched, depth unknown" if result.touched else "no contact"


def panel(image: U8, result: Reconstruction, geometry: Geometry) -> U8:
    """One reconstruction, uint8 BGR: the image with axes in px, and the height in mm with contact,
    a colour bar and axes in mm in the plane of the visible circle, from its centre.
    """
    left = _bgr(image)
    rows, cols = left.shape[:2]
    top = max(float(np.nanmax(result.height.height_mm, initial=0.0)), 0.1)
    right = _coloured(result.height, (cols, rows), top)
    text = text_of(result.reason) or (
        (
            f"{result.profile}: {counted(len(result.objects), 'object')}, deepest "
            f"{result.depth_max_mm:.2f} mm{' SATURATED' if result.saturated else ''} "
            f"{text_of(result.degraded)}"
        )
        if result.contact
        else f"{result.profile}: {_without_depth(result)} {text_of(result.degraded)}"
    )
    disc, mm = geometry.disc, geometry.mm_per_px
    pictures = np.hstack(
        [
            framed(left, Axis("col (px)"), Axis("row (px)")),
            framed(
                right, Axis("x (mm)", -disc.col_c * mm, mm), Axis("y (mm)", -disc.row_c * mm, mm)
            ),
            colour_bar(rows, top, "h (mm)"),
        ]
    )
    return with_legend(pictures, text)


@dataclass(frozen=True, slots=True)
class Tile:
    """One picture of a contact sheet: its thumbnail, uint8 (H, W, 3) BGR, its map, the part of the
    image that both show, and a line of text.
    """

    thumbnail: U8
    height: HeightMap
    image_size_px: tuple[int, int]
    part: tuple[slice, slice]
    text: str


def tile(name: str, image: U8, result: Reconstruction, disc: Disc) -> Tile:
    """The tile of an image, uint8 (H, W) or (H, W, 3) BGR, around its disc."""
    rows, cols = image.shape[:2]
    radius = _AROUND_DISC * disc.radius_px
    part = _around(disc.row_c, radius, rows), _around(disc.col_c, radius, cols)
    seen = image[part]
    high, wide = seen.shape[:2]
    small = cv2.resize(
        seen, (TILE_PX, max(round(high * TILE_PX / wide), 1)), interpolation=cv2.INTER_AREA
    )
    found = (
        f"{result.depth_max_mm:.2f} mm"
        if result.contact
        else code_of(result.reason) or _without_depth(result)
    )
    text = f"{name[-24:]}: {found}"
    return Tile(
        _bgr(np.asarray(small, np.uint8)),
        result.height,
        (cols, rows),
        part,
        text,
    )


def _around(middle_px: float, radius_px: float, length_px: int) -> slice:
    """The pixels within a radius, at least one of them."""
    first = min(max(math.floor(middle_px - radius_px), 0), length_px - 1)
    return slice(first, max(min(math.ceil(middle_px + radius_px) + 1, length_px), first + 1))


def contact_sheet(tiles: Sequence[Tile]) -> U8:
    """Pictures beside their maps, uint8 BGR, in `SHEET_COLUMNS` columns;
    all maps in the same colours.
    """
    top = max(*(float(np.nanmax(each.height.height_mm, initial=0.0)) for each in tiles), 0.1)
    drawn, tallest = [], max(len(each.thumbnail) for each in tiles)
    for each in tiles:
        rows, cols = each.thumbnail.shape[:2]
        map_ = cv2.resize(
            _coloured(each.height, each.image_size_px, top)[each.part],
            (cols, rows),
            interpolation=cv2.INTER_AREA,
        )
        whole = with_legend(np.hstack([each.thumbnail, map_]), each.text)
        drawn.append(
            cv2.copyMakeBorder(
                whole, 0, 4 + tallest - rows, 0, 4, cv2.BORDER_CONSTANT, value=_WHITE
            )
        )
    drawn += [np.full_like(drawn[0], 255)] * (-len(drawn) % SHEET_COLUMNS)
    sheet = np.vstack(
        [np.hstack(drawn[k : k + SHEET_COLUMNS]) for k in range(0, len(drawn), SHEET_COLUMNS)]
    )
    # A row of wide pictures is lower than any bar that can be read.
    bar_px = min(max(sheet.shape[0] - TOP_PX - BOTTOM_PX, _BAR_LEAST_PX), _BAR_MOST_PX)
    bar = colour_bar(bar_px, top, "h (mm)")
    tallest = max(len(sheet), len(bar))
    return np.hstack([_extended(sheet, tallest), _extended(bar, tallest)])


def _extended(picture: U8, rows: int) -> U8:
    """A picture with white below it, `rows` high."""
    below = rows - len(picture)
    return np.asarray(
        cv2.copyMakeBorder(picture, 0, below, 0, 0, cv2.BORDER_CONSTANT, value=_WHITE), np.uint8
    )


def reference_picture(
    grey: U8,
    calibration: Calibration | None = None,
    places_px: Sequence[Sequence[float]] = (),
    guess: Disc | None = None,
) -> U8:
    """A reference, uint8 (H, W), with axes in px, uint8 BGR; of a calibration also the visible
    circle and its middle, the white's outlines, five pitches, and the presses' places (column,
    row); else the likeliest circle, drawn thinly.
    """
    zoom = max(1, SEEN_PX // max(grey.shape))
    picture = _zoomed(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), zoom)
    if calibration is not None:
        text = _draw_calibration(picture, calibration, places_px, zoom)
    elif guess is not None:
        _draw_circle(picture, guess, zoom, thickness_px=1)
        text = f"uncertain {_circle_text(guess)}; state visible_circle in SENSOR.yaml"
    else:
        text = "no circle found: state visible_circle in SENSOR.yaml"
    # Pixel 0 begins at -0.5; the middle of the first enlarged pixel is half of one further.
    x, y = (Axis(f"{name} (px)", 0.5 / zoom - 0.5, 1 / zoom) for name in ("col", "row"))
    return with_legend(framed(picture, x, y), text)


def _draw_calibration(
    picture: U8, calibration: Calibration, places_px: Sequence[Sequence[float]], zoom: int
) -> str:
    """Draw what was found on a reference; returns it in words."""
    white = _zoomed(calibration.reference_white, zoom)
    _outline(picture, (white > _HALF_WHITE).astype(np.uint8), cv2.RETR_LIST, _OUTLINE)
    _draw_circle(picture, calibration.geometry.disc, zoom, thickness_px=2)
    for col, row in places_px:
        cv2.drawMarker(picture, _middle_px(row, col, zoom), _PLACE, cv2.MARKER_TILTED_CROSS, 10, 2)
    end = _BAR_AT_PX + round(_BAR_PITCHES * calibration.pitch_px * zoom)
    row = len(picture) - _BAR_AT_PX
    cv2.line(picture, (_BAR_AT_PX, row), (end, row), _FOUND, 3)
    return (
        f"{_circle_text(calibration.geometry.disc)}; bar: {_BAR_PITCHES} pitches of "
        f"{calibration.pitch_px:.1f} px; {calibration.polarity}, {calibration.binarisation}"
    )


def _draw_circle(picture: U8, disc: Disc, zoom: int, *, thickness_px: int) -> None:
    middle = _middle_px(disc.row_c, disc.col_c, zoom)
    radius = round(disc.radius_px * zoom)
    cv2.circle(picture, middle, radius, _FOUND, thickness_px, cv2.LINE_AA)
    cv2.drawMarker(picture, middle, _FOUND, cv2.MARKER_CROSS, 12, 2)


def _circle_text(disc: Disc) -> str:
    return f"circle: row {disc.row_c:.0f}, column {disc.col_c:.0f}, radius {disc.radius_px:.0f} px"


def _zoomed(image: U8, zoom: int) -> U8:
    # Interpolation would blur on which pixel a rim lies.
    enlarged = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_NEAREST)
    return np.asarray(enlarged, np.uint8)


def _middle_px(row: float, col: float, zoom: int) -> tuple[int, int]:
    """Where the middle of a pixel is in the enlarged picture: column, row."""
    return round((col + 0.5) * zoom), round((row + 0.5) * zoom)


def height_png(height_mm: F32) -> bytes:
    """A height map (rows, cols) as PNG, three pixels a cell, white outside the disc,
    beside its colour bar.
    """
    top = max(float(np.nanmax(height_mm, initial=0.0)), 0.1)
    picture = colours(height_mm, 0.0, top, 255).repeat(3, axis=0).repeat(3, axis=1)
    padded = cv2.copyMakeBorder(picture, TOP_PX, BOTTOM_PX, 0, 0, cv2.BORDER_CONSTANT, value=_WHITE)
    return bytes(
        cv2.imencode(".png", np.hstack([padded, colour_bar(len(picture), top, "h (mm)")]))[1]
    )


def colours(values: F32, low: float, high: float, elsewhere: int) -> U8:
    """Values from `low` to `high` in colours, uint8 BGR;
    where there is none, the grey `elsewhere`.
    """
    level = np.nan_to_num(np.clip((values - low) / (high - low), 0, 1) * 255).astype(np.uint8)
    picture = np.asarray(cv2.applyColorMap(level, _COLOURS), np.uint8)
    picture[~np.isfinite(values)] = elsewhere
    return picture


def _coloured(height: HeightMap, size: tuple[int, int], top: float) -> U8:
    """A map over an image of `size` (width, height):
    colours from 0 to `top` mm, contact outlined, white outside.
    """
    level = np.nan_to_num(np.clip(height.height_mm / top, 0, 1) * 255).astype(np.uint8)
    picture = np.asarray(
        cv2.applyColorMap(_over_image(level, height, size, cv2.INTER_LINEAR), _COLOURS), np.uint8
    )
    seen = _over_image(
        np.isfinite(height.height_mm).astype(np.uint8), height, size, cv2.INTER_NEAREST
    )
    picture[seen == 0] = 255
    touched = _over_image(height.contact.astype(np.uint8), height, size, cv2.INTER_NEAREST)
    _outline(picture, touched, cv2.RETR_EXTERNAL, _WHITE)
    return picture


def _outline(picture: U8, mask: U8, mode: int, colour: tuple[int, int, int]) -> None:
    outlines, _ = cv2.findContours(mask, mode, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, outlines, -1, colour, 1)


def _over_image(values: U8, grid: HeightMap, size: tuple[int, int], interpolation: int) -> U8:
    """The values of a map's cells resampled to an image of `size` (width, height);
    0 outside the map.
    """
    to_cell = np.array(((1, 0, -grid.col0), (0, 1, -grid.row0))) / grid.step_px
    return np.asarray(
        cv2.warpAffine(values, to_cell, size, flags=interpolation | cv2.WARP_INVERSE_MAP), np.uint8
    )


def with_legend(picture: U8, text: str) -> U8:
    legend = np.full((_LEGEND_PX, picture.shape[1], 3), 255, dtype=np.uint8)
    cv2.putText(legend, encodable(text[:120]), (6, 15), _FONT, 0.45, _BLACK, 1, cv2.LINE_AA)
    return np.vstack([picture, legend])


def _bgr(image: U8) -> U8:
    """A grey or BGR image as BGR."""
    if image.ndim == _DIMENSIONS_BGR:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)


def _width_px(text: str) -> int:
    return int(cv2.getTextSize(text, _FONT, _SCALE, 1)[0][0])


def _write(paper: U8, text: str, col: int, row: int) -> None:
    cv2.putText(paper, encodable(text), (max(col, 0), row), _FONT, _SCALE, _BLACK, 1, cv2.LINE_AA)
