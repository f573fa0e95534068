"""Pictures that another program, or the camera, has mirrored or turned."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import cv2
import numpy as np

from tacshade_edge.reasons import Reason
from tacshade_edge.types import F32, U8

_TURNS: Final[Mapping[str, Callable[[U8], U8]]] = {
    "mirrored left to right": np.fliplr,
    "mirrored top to bottom": np.flipud,
    "turned by 180 degrees": lambda image: np.rot90(image, 2),
    "turned by 90 degrees clockwise": lambda image: np.rot90(image, -1),
    "turned by 90 degrees counter-clockwise": np.rot90,
    "with rows and columns swapped": lambda image: image.swapaxes(0, 1),
    "with rows and columns swapped, turned by 180 degrees": lambda image: np.rot90(
        image.swapaxes(0, 1), 2
    ),
}
"""Each way in which a picture may have been turned, by how it is undone."""

# A picture that shows the reference less than this, by the correlation of their patterns, shows
# it turned by so much more. Deep presses leave 0.5 and more, the wrong way at most 0.6.
_ALIKE, _FARTHER = 0.7, 0.3
# Part of a picture's height over which its light is averaged, and left out.
_LIGHT = 1 / 15


def likelier_turn(grey: U8, reference_grey: U8) -> str:
    """How a picture is turned that shows the reference far better when turned back; empty if it
    does not. Of a sensor whose pattern and surround are regular, no judge refuses such a picture.
    """
    reference = _pattern(reference_grey)
    as_is = _alike(_pattern(grey), reference)
    if grey.shape != reference_grey.shape or as_is >= _ALIKE:
        return ""
    for name, turn in _TURNS.items():
        turned = np.ascontiguousarray(turn(grey))
        if turned.shape == reference_grey.shape:
            alike = _alike(_pattern(turned), reference)
            if alike > max(_ALIKE - _FARTHER, as_is + _FARTHER):
                return name
    return ""


def _pattern(grey: U8) -> F32:
    level = grey.astype(np.float32)
    side = 2 * round(len(grey) * _LIGHT / 2) + 1
    return np.asarray(level - cv2.blur(level, (side, side)), np.float32)


def _alike(one: F32, other: F32) -> float:
    """The correlation of two patterns; 0 of one without contrast or of another size."""
    if one.shape != other.shape:
        return 0.0
    size = float(np.sqrt(np.sum(one * one, dtype=np.float64) * np.sum(other * other)))
    return float(np.sum(one * other, dtype=np.float64)) / size if size > 0 else 0.0


def with_turn(
    reason: Reason, image: U8, size: tuple[int, int], passes: Callable[[U8], bool]
) -> Reason:
    """The reason why an image is refused, with the way of turning it in which one of this size
    (rows, cols) passes, if there is one.
    """
    for name, turn in _TURNS.items():
        turned = np.ascontiguousarray(turn(image))
        if turned.shape[:2] == size and passes(turned):
            text = f"{reason}; it passes {name}: has the camera or a program done that?"
            return Reason(reason.code, text)
    return reason
