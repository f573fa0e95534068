"""Judge the picture: has it the right size, and does it show anything at all?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.core.image.white import level_at
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import U8, Bool

# A working camera never shows a disc this dark, or as flat as either of these (grey levels, part of the reference's
# deviation).
BLACK_LEVEL = 12.0
FLAT_STD, FLAT_OVER_REFERENCE = 4.0, 0.5
# At most this part more than in the reference, which may arrive thresholded, is saturated.
SATURATED_LEVEL, SATURATED_PART = 250, 0.25
# Median difference of neighbouring pixels: flat places of the pattern keep it near the noise.
NOISE_STEP, NOISE_OVER_REFERENCE = 9.0, 5.0

Box = tuple[slice, slice]


@dataclass(frozen=True, slots=True)
class Measured:
    """A figure of a frame, the limits within which its judge lets the frame pass, and the reason beyond them."""

    judge: str
    what: str
    found: float
    least: float
    most: float
    reason: Reason

    @property
    def refuses(self) -> bool:
        """Whether the judge refuses the frame."""
        return not self.least <= self.found <= self.most


def size_reason(image: U8, shape: tuple[int, int]) -> Reason | None:
    """Why an image, (H, W) or (H, W, 3), has not the calibrated size; None if it has it."""
    if image.shape[:2] == shape:
        return None
    text = f"size: found {image.shape[1]}x{image.shape[0]} px, expected the calibration's {shape[1]}x{shape[0]} px"
    return Reason(ReasonCode.SIZE, text)


class PictureJudge:
    """Judges the pixels of the disc, `mask` bool (H, W), by the mean reference's, uint8 (H, W), if any."""

    def __init__(self, reference_grey: U8 | None, mask: Bool) -> None:
        rows, cols = (np.flatnonzero(mask.any(axis=axis)).tolist() or [0, -1] for axis in (1, 0))
        # One pixel to the left of the disc, so that each of its pixels has a neighbour.
        self._box = slice(rows[0], rows[-1] + 1), slice(max(cols[0] - 1, 0), cols[-1] + 1)
        self._mask: U8 = np.where(mask[self._box], np.uint8(255), np.uint8(0))
        self._pairs = np.ascontiguousarray(self._mask[::8, 1:])
        self._px = cv2.countNonZero(self._mask) if self._mask.size else 0
        self._flat_std, self._saturated_part, self._noise_step = FLAT_STD, SATURATED_PART, math.inf
        if not self._px or reference_grey is None:
            return
        reference = reference_grey[self._box]
        usual = reference[self._mask > 0]
        self._flat_std = min(FLAT_STD, FLAT_OVER_REFERENCE * float(usual.std()))
        self._saturated_part = SATURATED_PART + float(np.mean(usual >= SATURATED_LEVEL))
        self._noise_step = max(NOISE_STEP, self._step(reference) + NOISE_OVER_REFERENCE)

    def measured(self, grey: U8) -> tuple[Measured, ...]:
        """What is measured of an image, uint8 (H, W) of the reference's size."""
        if not self._px:
            reason = Reason(ReasonCode.NO_DISC, "disc: no pixel of the visible circle lies in the image")
            return (Measured("picture", "pixels of the disc", 0, 1, math.inf, reason),)
        disc = grey[self._box]
        mean, square = (cv2.norm(disc, kind, self._mask) / self._px for kind in (cv2.NORM_L1, cv2.NORM_L2SQR))
        std = math.sqrt(max(square - mean * mean, 0))
        saturated = 0.0
        if square > self._saturated_part * SATURATED_LEVEL**2:  # that many saturated pixels alone exceed this
            bright = cv2.bitwise_and(cv2.inRange(disc, SATURATED_LEVEL, 255), self._mask)
            saturated = cv2.countNonZero(bright) / self._px
        step = self._step(disc)
        burnt = f"saturated: {100 * saturated:.0f} % of the disc is at grey level {SATURATED_LEVEL} or above"
        code, word = (ReasonCode.BLACK, "black") if mean < BLACK_LEVEL else (ReasonCode.NO_CONTRAST, "no contrast")
        flat = f"{word}: mean grey level {mean:.0f}, standard deviation {std:.1f}"
        noise = f"noise: neighbouring pixels differ by {step:.0f} grey levels"
        return (
            Measured(
                "picture", "saturated part", saturated, 0, self._saturated_part, Reason(ReasonCode.SATURATED, burnt)
            ),
            Measured("picture", "standard deviation", std, self._flat_std, math.inf, Reason(code, flat)),
            Measured("picture", "pixel noise", step, 0, self._noise_step, Reason(ReasonCode.NOISE, noise)),
        )

    def _step(self, disc: U8) -> float:
        """Median difference of horizontal neighbours in the disc, on every eighth row."""
        if not self._pairs.size:
            return 0.0
        rows = disc[::8]
        return level_at(np.asarray(cv2.absdiff(rows[:, 1:], rows[:, :-1]), np.uint8), self._pairs, 0.5)
