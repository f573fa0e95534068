"""Refused pictures that another program, or the camera, has mirrored or turned."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from tacshade_edge.reasons import Reason
from tacshade_edge.types import U8

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
