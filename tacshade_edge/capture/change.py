"""How far a picture of the skin has changed from rest, in grey levels:
enough to see that something touches.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from tacshade_edge.types import F32

_FACTOR: Final = 2.0
_FLOOR_GREY: Final = 0.1
"""A contact changes a picture by more than this, above `_FACTOR` times the change at rest."""


class ChangeFromRest:
    """Compares block means (H // 8, W // 8) of pictures with those of some pictures at rest."""

    def __init__(self, rest: Sequence[F32]) -> None:
        # A mean has less noise than any picture, so a change from it is that of the new picture.
        self._rest: F32 = np.mean(rest, axis=0)
        self._at_rest_grey = max(self.grey(one) for one in rest)

    @property
    def least_grey(self) -> float:
        """The least change that counts as contact."""
        return _FACTOR * self._at_rest_grey + _FLOOR_GREY

    def grey(self, blocks: F32) -> float:
        """Mean change of a picture from rest in grey levels."""
        return change_grey(blocks, self._rest)

    def in_contact(self, blocks: F32) -> bool:
        """Whether a picture has changed by more than pictures at rest do."""
        return self.grey(blocks) > self.least_grey


def change_grey(blocks: F32, before: F32) -> float:
    """Mean change between two pictures, without the change that all blocks share (the light)."""
    # The median, as a contact covers less than half of the blocks and light changes all.
    change = blocks - before
    return float(np.abs(change - np.median(change)).mean())
