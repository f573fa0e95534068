"""Judge an image before a calibration exists: is the disc visible, sharp and well exposed?"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.core.calibration.reference.pattern import find_disc, marker_pitch_px, visible_disc
from tacshade_edge.core.frame_check.picture import SATURATED_LEVEL
from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import U8, Disc

# Rows of the image in which the circle is searched for: a third of the time, and within 1 px.
_SEARCH_ROWS = 240
# Part of the radius that is measured, without the housing's edge.
_INNER = 0.95
_PERCENTILES = (5, 95)
_SATURATED_PART, _CONTRAST_GREY = 0.02, 30.0


@dataclass(frozen=True, slots=True)
class Pattern:
    """The disc of the marker pattern in an image, and its pitch in px."""

    disc: Disc
    pitch_px: float


@dataclass(frozen=True, slots=True)
class View:
    """How well an image shows the pattern.

    `focus`: fine over coarse detail: RMS of the Laplacian over that of the pattern, whatever the light. Greatest when
    the lens is sharpest (an energy of Laplacian, Subbarao, Choi and Nikzad 1993); not comparable between sensors.
    `contrast_grey`: contrast of the markers: 5th to 95th percentile in the disc, without slow variation of light; grey
    levels. `saturated_part`: part of the disc at 250 grey levels or above.
    """

    focus: float
    contrast_grey: float
    saturated_part: float

    @property
    def advice(self) -> str:
        """What to fix; empty if nothing."""
        if self.saturated_part > _SATURATED_PART:
            return "too bright: use less light or a shorter exposure"
        if self.contrast_grey < _CONTRAST_GREY:
            return "too flat: use more light, a longer exposure or a sharper lens"
        return ""


def find_pattern(grey: U8, stated: Disc | None = None) -> Pattern:
    """Find the disc and the pitch. `grey`: uint8 (H, W). `stated`: the circle, if the user stated it. Raises
    ConfigError (the image shows no circle, or no pattern in it).
    """
    if stated is not None:
        return Pattern(visible_disc(grey, stated), marker_pitch_px(grey, stated))
    scale = max(grey.shape[0] / _SEARCH_ROWS, 1.0)
    if min(grey.shape) < 16 * scale:
        raise ConfigError(
            f"found no visible circle: the image is too small or too narrow ({grey.shape[1]}x{grey.shape[0]} px)"
        )
    small = cv2.resize(grey, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)
    disc = find_disc(np.asarray(small, np.uint8))
    # Pixel centres are whole numbers: resizing keeps the image's corners, not its first pixel.
    row_c, col_c = ((centre + 0.5) * scale - 0.5 for centre in (disc.row_c, disc.col_c))
    found = Disc(row_c, col_c, disc.radius_px * scale)
    return Pattern(found, marker_pitch_px(grey, found))


def view(grey: U8, pattern: Pattern) -> View:
    """Measure how well an image shows the pattern. `grey`: uint8 (H, W). `pattern`: pattern of this image or an earlier
    one.
    """
    disc, (height, width) = pattern.disc, grey.shape
    inside = disc_mask(height, width, Disc(disc.row_c, disc.col_c, _INNER * disc.radius_px))
    if not inside.any():
        return View(0.0, 0.0, 0.0)
    values = grey.astype(np.float32)
    side = max(int(2 * pattern.pitch_px) | 1, 3)
    detail = (values - cv2.blur(values, (side, side)))[inside]
    fine = cv2.Laplacian(cv2.GaussianBlur(values, (0, 0), 1.0), cv2.CV_32F)[inside]
    low, high = np.percentile(detail, _PERCENTILES)
    return View(
        focus=float(fine.std() / max(detail.std(), 1e-3)),
        contrast_grey=float(high - low),
        saturated_part=float(np.mean(grey[inside] >= SATURATED_LEVEL)),
    )
