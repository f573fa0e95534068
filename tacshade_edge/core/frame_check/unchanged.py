"""Whether a frame shows the untouched skin of a frame before it, so that nothing needs to be looked at again.

A free skin is what most frames show, and all of what is checked and thresholded in one comes out as in the last.
"""

from __future__ import annotations

import cv2

from tacshade_edge.core.frame_check.validity import FrameCheck
from tacshade_edge.core.image.halving import halved_image
from tacshade_edge.reasons import Reason
from tacshade_edge.types import U8

LEVELS = 8.0
"""What camera noise of 2 levels may change in the brightest of all pixels: means of 2x2 px differ by 6 at most, four
deviations. A press that grows by a few hundredths of a millimetre changes more, so none is felt later than without."""


class UnchangedSkin:
    """The latest untouched skin that was judged in full; frames are compared with that one, so changes add up.

    Parameters
    ----------
    check : FrameCheck
        What it looks at is what has to be unchanged.
    halved : bool
        The images are halved ones already.

    Attributes
    ----------
    degraded : Reason or None
        Why that frame was degraded.
    """

    def __init__(self, check: FrameCheck, halved: bool) -> None:
        boxes = [check.disc] if check.blocks is None else [check.disc, check.blocks.box]
        halved = halved or min(check.shape) < 2
        per_px = 1 if halved else 2
        self._box = tuple(
            slice(min(box[axis].start for box in boxes) // per_px, -(max(box[axis].stop for box in boxes) // -per_px))
            for axis in (0, 1)
        )
        self._halved = halved
        self._kept: U8 | None = None
        self.degraded: Reason | None = None

    def shown_in(self, grey: U8) -> bool:
        """Whether an image, uint8 (H, W), shows it."""
        if self._kept is None:
            return False
        return cv2.norm(self._looked_at(grey), self._kept, cv2.NORM_INF) <= LEVELS

    def keep(self, grey: U8, degraded: Reason | None) -> None:
        """Remember an image, uint8 (H, W), that was judged to be valid and without contact."""
        shown = self._looked_at(grey)
        self._kept, self.degraded = shown.copy() if shown.size else None, degraded  # nothing of some tiny pictures

    def _looked_at(self, grey: U8) -> U8:
        """What is compared: of the halved image, since a camera's noise is half as large there."""
        return (grey if self._halved else halved_image(grey))[self._box]
