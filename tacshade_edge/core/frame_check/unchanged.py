"""Check whether a frame shows the untouched skin of an earlier frame, which saves checking it again.

Most frames show free skin, and all checks and thresholds then give the previous result.
"""

from __future__ import annotations

import cv2

from tacshade_edge.core.frame_check.validity import FrameCheck
from tacshade_edge.core.image.halving import halved_image
from tacshade_edge.reasons import Reason
from tacshade_edge.types import U8

LEVELS = 8.0
"""Greatest change of a pixel under camera noise of 2 levels: means of 2x2 px differ by at most 6, four deviations. A
press that grows by a few hundredths of a millimetre changes more, so no contact is found later."""


class UnchangedSkin:
    """The latest untouched skin checked in full. Frames are compared with that one, so slow changes add up.

    Parameters
    ----------
    check : FrameCheck
        The pixels that it uses must be unchanged.
    halved : bool
        Whether the images are already halved.

    Attributes
    ----------
    degraded : Reason or None
        Why that frame was degraded; None if it was not.
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
        """Whether an image, uint8 (H, W), shows the same untouched skin."""
        if self._kept is None:
            return False
        return cv2.norm(self._looked_at(grey), self._kept, cv2.NORM_INF) <= LEVELS

    def keep(self, grey: U8, degraded: Reason | None) -> None:
        """Remember an image, uint8 (H, W), that was found valid and without contact."""
        shown = self._looked_at(grey)
        self._kept, self.degraded = shown.copy() if shown.size else None, degraded  # some tiny images leave nothing

    def _looked_at(self, grey: U8) -> U8:
        """The pixels to compare, from the halved image, since the camera's noise is half as large there."""
        return (grey if self._halved else halved_image(grey))[self._box]
