"""Judge the light: how has the whole picture changed, whatever touches the skin?"""

from __future__ import annotations

import math

import cv2
import numpy as np

from tacshade_edge.core.frame_check.picture import Measured
from tacshade_edge.core.image.white import eighth, level_at, median, squares
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import U8, Bool

# Beyond this change of light, the binarised image cannot be compared with the reference's.
LIGHT_LOW, LIGHT_HIGH = 0.45, 1.7
# The brightest tenth of the disc, or less if less is bright, shows how much light is left: a deep contact darkens or
# brightens most of the disc, but some markers stay as bright as the light. More light saturates them; then the common
# level of the 8x8 px with markers (at least this deviation, levels) shows it.
BRIGHT_PART, TEXTURED_STD = 0.1, 8.0
# A common change of g above the first degrades a frame; above the second the frame is another image.
DRIFT_LEVELS, DRIFT_INVALID_LEVELS = 12.0, 30.0
# With more of the disc under glare than this, the rest shows too little.
UNSEEN_INVALID = 0.4
# Change of light between references that is compensated, and limits of unevenness and blur beyond all good presses
# (calibration-checks.md).
COMPENSATED_LOW, COMPENSATED_HIGH, UNEVEN, CONTRAST = 0.8, 1.25, 0.08, 0.8


class LightJudge:
    """Judges the light of the disc, `mask` bool (H, W), by that of the mean reference, uint8 (H, W)."""

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
        whole = eighth(np.where(mask, np.uint8(255), np.uint8(0))) == 255
        mean, deviation = squares(reference_grey, 8)
        self._textured = np.flatnonzero(whole & (deviation >= TEXTURED_STD))
        self._common = max(median(mean.take(self._textured)), 1.0) if self._textured.size else 1.0

    def measured(self, grey: U8, eighths: U8) -> tuple[Measured, ...]:
        """What is measured of an image, uint8 (H, W), and its means over 8x8 px."""
        if not self._textured.size:
            return ()
        least = level_at(np.ascontiguousarray(grey[::4, ::4]), self._sampled, 1 - self._bright_part) / self._bright
        most = median(eighths.take(self._textured).astype(np.float32)) / self._common
        return (
            Measured("light", "light of the brightest", least, LIGHT_LOW, math.inf, _light(least)),
            Measured("light", "light of all", most, 0, LIGHT_HIGH, _light(most)),
        )


def white_measured(unseen: float, drift_grey: float) -> tuple[Measured, ...]:
    """What is measured of the white: the part of the disc under glare, the common change of g in grey levels."""
    return (
        Measured("light", "part under glare", unseen, 0, UNSEEN_INVALID, _glare(unseen)),
        Measured("light", "common change of white", abs(drift_grey), 0, DRIFT_INVALID_LEVELS, _drift(drift_grey)),
    )


def degraded_reason(unseen: float, drift_grey: float) -> Reason | None:
    """Why a valid frame is degraded; None if it is not. The parameters are those of `white_measured`."""
    if abs(drift_grey) > DRIFT_LEVELS:
        return _drift(drift_grey)
    return _glare(unseen) if unseen > 0 else None


def light_drift_reason(light: float, uneven: float, contrast: float) -> Reason | None:
    """Why an image of the skin needs a new reference: light or focus changed; None if that is compensated.

    The parameters are those of `camera.Drift`.
    """
    changes = []
    if not COMPENSATED_LOW <= light <= COMPENSATED_HIGH:
        changes.append(f"{light:.2f} times the light")
    if uneven > UNEVEN:
        changes.append(f"the light falls differently (it varies by {100 * uneven:.0f} % over the disc)")
    if contrast < CONTRAST:
        changes.append(f"blurred or dirty ({contrast:.2f} times the contrast)")
    return Reason(ReasonCode.LIGHT_DRIFT, ", ".join(changes)) if changes else None


def _light(found: float) -> Reason:
    text = f"light: found {found:.2f} times the reference's brightness, expected {LIGHT_LOW} to {LIGHT_HIGH} times"
    return Reason(ReasonCode.LIGHT, text)


def _glare(unseen: float) -> Reason:
    return Reason(ReasonCode.GLARE, f"glare hides {100 * unseen:.0f} % of the disc")


def _drift(drift_grey: float) -> Reason:
    text = f"light or focus: the white ratio changed by {drift_grey:.0f} levels everywhere"
    return Reason(ReasonCode.LIGHT_DRIFT, text)
