"""Draws axes and a colour bar around a picture without a plotting library, which boards lack."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.types import U8

LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 44, 14, 20, 36
BAR_PX = 78
_FONT, _SCALE, _TICK_PX = cv2.FONT_HERSHEY_SIMPLEX, 0.38, 4
_LABEL_EVERY_PX = 46  # least distance between ticks
_BLACK = (0, 0, 0)


@dataclass(frozen=True, slots=True)
class Axis:
    """The scale along one side of a picture.

    Attributes
    ----------
    label : str
        With the unit; ASCII.
    first, per_px : float
        The value at the middle of pixel 0, and its increase per pixel.
    """

    label: str
    first: float = 0.0
    per_px: float = 1.0


def ticks(axis: Axis, length_px: int) -> list[tuple[float, float]]:
    """Round values along an axis, each with its position in px."""
    step = _round_step(_LABEL_EVERY_PX * axis.per_px)
    last = axis.first + (length_px - 1) * axis.per_px
    values = [k * step for k in range(math.ceil(axis.first / step), math.floor(last / step) + 1)]
    return [(value, (value - axis.first) / axis.per_px) for value in values]


def framed(picture: U8, x: Axis, y: Axis) -> U8:
    """The picture, uint8 (H, W, 3) BGR, on white with two axes; its corner is at row `TOP_PX`, column `LEFT_PX`."""
    rows, cols = picture.shape[:2]
    paper = np.full((TOP_PX + rows + BOTTOM_PX, LEFT_PX + cols + RIGHT_PX, 3), 255, np.uint8)
    paper[TOP_PX : TOP_PX + rows, LEFT_PX : LEFT_PX + cols] = picture
    cv2.rectangle(paper, (LEFT_PX - 1, TOP_PX - 1), (LEFT_PX + cols, TOP_PX + rows), _BLACK, 1)
    for value, at_px in ticks(x, cols):
        place = LEFT_PX + round(at_px), TOP_PX + rows
        cv2.line(paper, place, (place[0], place[1] + _TICK_PX), _BLACK, 1)
        text = f"{value:g}"
        _write(paper, text, place[0] - _width_px(text) // 2, place[1] + _TICK_PX + 12)
    _write(paper, x.label, LEFT_PX + (cols - _width_px(x.label)) // 2, TOP_PX + rows + BOTTOM_PX - 5)
    _vertical(paper, y, rows, LEFT_PX - 1, -1)
    _write(paper, y.label, 4, TOP_PX - 7)
    return paper


def colour_bar(colours: int, height_px: int, top: float, label: str) -> U8:
    """A bar of an OpenCV colour map from 0 to `top`, as high as a picture of `height_px` rows after `framed`."""
    paper = np.full((TOP_PX + height_px + BOTTOM_PX, BAR_PX, 3), 255, np.uint8)
    levels = np.linspace(255, 0, height_px).astype(np.uint8)[:, None].repeat(12, axis=1)
    paper[TOP_PX : TOP_PX + height_px, 4:16] = cv2.applyColorMap(levels, colours)
    cv2.rectangle(paper, (3, TOP_PX - 1), (16, TOP_PX + height_px), _BLACK, 1)
    per_px = top / max(height_px - 1, 1)
    for value, from_bottom_px in ticks(Axis(label, 0.0, per_px), height_px):
        row = TOP_PX + height_px - 1 - round(from_bottom_px)
        cv2.line(paper, (16, row), (16 + _TICK_PX, row), _BLACK, 1)
        _write(paper, f"{value:g}", 24, row + 4)
    _write(paper, label, 2, TOP_PX - 7)
    return paper


def _vertical(paper: U8, axis: Axis, length_px: int, col: int, direction: int) -> None:
    for value, at_px in ticks(axis, length_px):
        row = TOP_PX + round(at_px)
        cv2.line(paper, (col, row), (col + direction * _TICK_PX, row), _BLACK, 1)
        text = f"{value:g}"
        _write(paper, text, col - _TICK_PX - 2 - _width_px(text), row + 4)


def _round_step(least: float) -> float:
    """The least step of 1, 2 or 5 times a power of ten that is not below `least`."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least)


def _width_px(text: str) -> int:
    return int(cv2.getTextSize(text, _FONT, _SCALE, 1)[0][0])


def _write(paper: U8, text: str, col: int, row: int) -> None:
    cv2.putText(paper, text, (max(col, 0), row), _FONT, _SCALE, _BLACK, 1, cv2.LINE_AA)
