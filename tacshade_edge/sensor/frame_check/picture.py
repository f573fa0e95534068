"""Judge the picture and its light: has it the right size, shows it anything,
and how has it changed as a whole?
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.image.white import eighth, level_at, median, squares
from tacshade_edge.types import U8, Bool

# A working camera never shows a disc this dark, or as flat as either of these (grey levels, part of
# the reference's deviation).
BLACK_LEVEL = 12.0
FLAT_STD, FLAT_OVER_REFERENCE = 4.0, 0.5
# At most this part more than in the reference, which may arrive thresholded, is saturated.
SATURATED_LEVEL, SATURATED_PART = 250, 0.25
# Median difference of neighbouring pixels: flat places of the pattern keep it near the noise.
NOISE_STEP, NOISE_OVER_REFERENCE = 9.0, 5.0

_WHOLE = 255  # the mean of a mask over a block that it covers, and the greatest level

Box = tuple[slice, slice]


@dataclass(frozen=True, slots=True)
class Measured:
    """A figure of a frame, the limits within which its judge lets the frame pass,
    and the reason beyond them.
    """

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
    text = (
        f"size: found {image.shape[1]}x{image.shape[0]} px, expected the calibration's "
        f"{shape[1]}x{shape[0]} px"
    )
    return Reason(ReasonCode.SIZE, text)


class PictureJudge:
    """Judges the pixels of the disc, `mask` bool (H, W), by the mean reference's, uint8 (H, W),
    if any.
    """

    def __init__(self, reference_grey: U8 | None, mask: Bool) -> None:
        rows, cols = (np.flatnonzero(mask.any(axis=axis)).tolist() or [0, -1] for axis in (1, 0))
        # One pixel to the left of the disc, so that each of its pixels has a neighbour.
        self._box = slice(rows[0], rows[-1] + 1), slice(max(cols[0] - 1, 0), cols[-1] + 1)
        self._mask: U8 = np.where(mask[self._box], np.uint8(255), np.uint8(0))
        self._pairs = np.ascontiguousarray(self._mask[::8, 1:])
        self._px = cv2.countNonZero(self._mask) if self._mask.size else 0
        self._has_pair: Bool = self._pairs > 0
        self._pair_count = int(np.count_nonzero(self._has_pair))
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
            reason = Reason(
                ReasonCode.NO_DISC, "disc: no pixel of the visible circle lies in the image"
            )
            return (Measured("picture", "pixels of the disc", 0, 1, math.inf, reason),)
        disc = grey[self._box]
        mean, square, std = self._moments(disc)
        saturated = 0.0
        if (
            square > self._saturated_part * SATURATED_LEVEL**2
        ):  # that many saturated pixels alone exceed this
            bright = cv2.bitwise_and(cv2.inRange(disc, SATURATED_LEVEL, 255), self._mask)
            saturated = cv2.countNonZero(bright) / self._px
        step = self._step(disc)
        burnt = (
            f"saturated: {100 * saturated:.0f} % of the disc is at grey level {SATURATED_LEVEL} or "
            "above"
        )
        code, word = (
            (ReasonCode.BLACK, "black")
            if mean < BLACK_LEVEL
            else (ReasonCode.NO_CONTRAST, "no contrast")
        )
        flat = f"{word}: mean grey level {mean:.0f}, standard deviation {std:.1f}"
        noise = f"noise: neighbouring pixels differ by {step:.0f} grey levels"
        return (
            Measured(
                "picture",
                "saturated part",
                saturated,
                0,
                self._saturated_part,
                Reason(ReasonCode.SATURATED, burnt),
            ),
            Measured(
                "picture", "standard deviation", std, self._flat_std, math.inf, Reason(code, flat)
            ),
            Measured(
                "picture", "pixel noise", step, 0, self._noise_step, Reason(ReasonCode.NOISE, noise)
            ),
        )

    def passes(self, grey: U8) -> bool:
        """Whether an image clearly passes, faster than it is measured."""
        if not self._px:
            return False
        disc = grey[self._box]
        _, square, std = self._moments(disc)
        if square > self._saturated_part * SATURATED_LEVEL**2 or std < self._flat_std:
            return False
        # A median is within a limit if at most half of the values are beyond it.
        if self._noise_step >= _WHOLE or not self._pairs.size:
            return True
        beyond = self._steps(disc) > math.floor(self._noise_step)
        beyond &= self._has_pair
        return 2 * int(np.count_nonzero(beyond)) <= self._pair_count

    def _moments(self, disc: U8) -> tuple[float, float, float]:
        """Mean, mean square and deviation of the disc's pixels."""
        mean, square = (
            cv2.norm(disc, kind, self._mask) / self._px for kind in (cv2.NORM_L1, cv2.NORM_L2SQR)
        )
        return mean, square, math.sqrt(max(square - mean * mean, 0))

    def _step(self, disc: U8) -> float:
        """Median difference of horizontal neighbours in the disc, on every eighth row."""
        return level_at(self._steps(disc), self._pairs, 0.5) if self._pairs.size else 0.0

    @staticmethod
    def _steps(disc: U8) -> U8:
        rows = disc[::8]
        return np.asarray(cv2.absdiff(rows[:, 1:], rows[:, :-1]), np.uint8)


# Beyond this change of light, the binarised image cannot be compared with the reference's.
LIGHT_LOW, LIGHT_HIGH = 0.45, 1.7
# The brightest tenth of the disc, or less if less is bright, shows how much light is left: a deep
# contact darkens or brightens most of the disc, but some markers stay as bright as the light. More
# light saturates them; then the common level of the 8x8 px with markers (at least this deviation,
# levels) shows it.
BRIGHT_PART, TEXTURED_STD = 0.1, 8.0
# A common change of g above the first degrades a frame;
# above the second the frame is another image.
DRIFT_LEVELS, DRIFT_INVALID_LEVELS = 12.0, 30.0
# With more of the disc under glare than this, the rest shows too little.
UNSEEN_INVALID = 0.4
# Change of light between references that is compensated, and limits of unevenness and blur beyond
# all good presses (calibration-checks.md).
COMPENSATED_LOW, COMPENSATED_HIGH, UNEVEN, CONTRAST = 0.8, 1.25, 0.08, 0.8
_ROUNDING = 1e-6  # levels by which a quotient may err


class LightJudge:
    """Judges the light of the disc, `mask` bool (H, W), by that of the mean reference, uint8 (H,
    W).
    """

    def __init__(self, reference_grey: U8, mask: Bool) -> None:
        self._sampled: U8 = np.where(mask[::4, ::4], np.uint8(255), np.uint8(0))
        sample = np.ascontiguousarray(reference_grey[::4, ::4])
        inside = sample[self._sampled > 0].reshape(-1, 1)
        self._bright_part = BRIGHT_PART
        if inside.size:
            split, _ = cv2.threshold(inside, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
            # Half of the part above Otsu's level (1979): pins may cover a twentieth of the disc.
            self._bright_part = min(float(np.mean(inside > split)) / 2, BRIGHT_PART)
        self._bright = max(level_at(sample, self._sampled, 1 - self._bright_part), 1.0)
        whole = eighth(np.where(mask, np.uint8(255), np.uint8(0))) == _WHOLE
        mean, deviation = squares(reference_grey, 8)
        self._textured = np.flatnonzero(whole & (deviation >= TEXTURED_STD))
        self._common = max(median(mean.take(self._textured)), 1.0) if self._textured.size else 1.0
        # For `passes`: so many of the sampled pixels may be darker than the least light allows, and
        # so many of the blocks brighter than the most.
        self._is_sampled: Bool = self._sampled > 0
        self._few_dark = (1 - self._bright_part) * int(np.count_nonzero(self._is_sampled)) - 1
        self._few_bright = (self._textured.size - 1) // 2
        self._least = math.floor(LIGHT_LOW * self._bright) + 1
        self._most = min(math.floor(LIGHT_HIGH * self._common - _ROUNDING), _WHOLE)

    def passes(self, grey: U8, eighths: U8) -> bool:
        """Whether an image clearly passes, faster than it is measured."""
        if not self._textured.size:
            return True
        darker = grey[::4, ::4] < self._least
        darker &= self._is_sampled
        if int(np.count_nonzero(darker)) > self._few_dark:
            return False
        bright = eighths.take(self._textured) > self._most
        return int(np.count_nonzero(bright)) <= self._few_bright

    def measured(self, grey: U8, eighths: U8) -> tuple[Measured, ...]:
        """What is measured of an image, uint8 (H, W), and its means over 8x8 px."""
        if not self._textured.size:
            return ()
        least = (
            level_at(np.ascontiguousarray(grey[::4, ::4]), self._sampled, 1 - self._bright_part)
            / self._bright
        )
        most = median(eighths.take(self._textured).astype(np.float32)) / self._common
        return (
            Measured("light", "light of the brightest", least, LIGHT_LOW, math.inf, _light(least)),
            Measured("light", "light of all", most, 0, LIGHT_HIGH, _light(most)),
        )


def white_measured(unseen: float, drift_grey: float) -> tuple[Measured, ...]:
    """What is measured of the white: the part of the disc under glare,
    the common change of g in grey levels.
    """
    return (
        Measured("light", "part under glare", unseen, 0, UNSEEN_INVALID, _glare(unseen)),
        Measured(
            "light",
            "common change of white",
            abs(drift_grey),
            0,
            DRIFT_INVALID_LEVELS,
            _drift(drift_grey),
        ),
    )


def degraded_reason(unseen: float, drift_grey: float) -> Reason | None:
    """Why a valid frame is degraded; None if it is not.

    The parameters are those of `white_measured`.
    """
    if abs(drift_grey) > DRIFT_LEVELS:
        return _drift(drift_grey)
    return _glare(unseen) if unseen > 0 else None


def light_drift_reason(light: float, uneven: float, contrast: float) -> Reason | None:
    """Why an image needs a new reference, by the parameters of `camera.Drift`: light or focus
    changed; None if that is compensated.
    """
    changes = []
    if not COMPENSATED_LOW <= light <= COMPENSATED_HIGH:
        changes.append(f"{light:.2f} times the light")
    if uneven > UNEVEN:
        changes.append(
            f"the light falls differently (it varies by {100 * uneven:.0f} % over the disc)"
        )
    if contrast < CONTRAST:
        changes.append(f"blurred or dirty ({contrast:.2f} times the contrast)")
    return Reason(ReasonCode.LIGHT_DRIFT, ", ".join(changes)) if changes else None


def _light(found: float) -> Reason:
    text = (
        f"light: found {found:.2f} times the reference's brightness, expected {LIGHT_LOW} to "
        f"{LIGHT_HIGH} times"
    )
    return Reason(ReasonCode.LIGHT, text)


def _glare(unseen: float) -> Reason:
    return Reason(ReasonCode.GLARE, f"glare hides {100 * unseen:.0f} % of the disc")


def _drift(drift_grey: float) -> Reason:
    text = f"light or focus: the white ratio changed by {drift_grey:.0f} levels everywhere"
    return Reason(ReasonCode.LIGHT_DRIFT, text)
