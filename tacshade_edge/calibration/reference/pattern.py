"""Measure the marker pitch in a reference image, and how well an image shows the pattern."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.calibration.reference.marker_field import find_markers
from tacshade_edge.calibration.reference.visible_circle import HALF_FILLED, find_disc, visible_disc
from tacshade_edge.errors import ConfigError
from tacshade_edge.sensor.frame_check.picture import SATURATED_LEVEL
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.types import U8, Disc

# The patch is padded to this, so that the ring's radius has many bins, and its peak parts of one.
_SPECTRUM_PX = 1024
# Fewer bins between the slowest and the fastest pattern show no peak.
_LEAST_BAND = 8


def marker_pitch_px(grey: U8, disc: Disc) -> float:
    """Distance between neighbouring pin tips in the middle of the disc, px.

    Raises ConfigError without a pattern.
    """
    try:
        return _spectral_pitch_px(grey, disc)
    except ConfigError:
        field = find_markers(grey)
        if field is None or field.filled_part(disc, grey.shape) < HALF_FILLED:
            raise
        return field.pitch_px


def _spectral_pitch_px(grey: U8, disc: Disc) -> float:
    """The marker pitch from the pattern's spectrum, px: the lattice's first ring lies at 2 / (√3
    pitch), in the mean power over all directions in the middle of the disc, where perspective
    stretches it least.
    """
    half = max(int(0.5 * disc.radius_px), 8)
    row, col = round(disc.row_c), round(disc.col_c)
    patch = grey[max(row - half, 0) : row + half, max(col - half, 0) : col + half].astype(
        np.float32
    )
    patch = patch - cv2.blur(patch, (2 * (half // 3) + 1, 2 * (half // 3) + 1))
    # Without a window, the patch's edges would make a cross in the spectrum.
    window = np.hanning(patch.shape[0])[:, None] * np.hanning(patch.shape[1])[None, :]
    size = _SPECTRUM_PX
    power = np.abs(np.fft.rfft2(patch * window, s=(size, size))) ** 2
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    bins = np.minimum((frequency * size).astype(int), size // 2)
    ring = np.bincount(bins.ravel(), weights=power.ravel()) / np.maximum(
        np.bincount(bins.ravel()), 1
    )
    # From eight periods in the patch to one of 4 px: what is slower is light, what is faster noise.
    low, high = int(size * 4 / half), int(size * 0.25)
    band = ring[low:high]
    if band.size < _LEAST_BAND or not band.max() > 0:
        raise ConfigError(
            "found no marker pattern in the reference: the visible circle is too small"
        )
    # A ring is as wide as the pitch varies under perspective: single bins are noise.
    smooth = np.convolve(band, np.ones(5) / 5, "same")
    peaks = np.flatnonzero((smooth[1:-1] >= smooth[:-2]) & (smooth[1:-1] > smooth[2:])) + 1
    strong = [int(p) for p in peaks if smooth[p] >= 0.3 * smooth.max()]
    if not strong or smooth.max() < 5 * np.median(smooth):
        raise ConfigError(
            "found no marker pattern in the reference: the image's spectrum has no clear ring"
        )
    first = strong[0]  # the lowest strong ring, because a honeycomb's second ring can be stronger
    near = slice(max(first - 4, 0), first + 5)
    weights = smooth[near]
    peak = float((weights * np.arange(band.size)[near]).sum() / weights.sum()) + low + 0.5
    return float(2 / np.sqrt(3) * size / peak)


def mean_image(images: Sequence[U8]) -> U8:
    """Rounded mean of equally sized grey images."""
    return np.rint(np.mean(images, axis=0, dtype=np.float32)).astype(np.uint8)


# Rows of the image in which the circle is searched for: a third of the time, and within 1 px.
_PATTERN_ROWS = 240
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
class PatternView:
    """How well an image shows the pattern."""

    # RMS of the Laplacian over the pattern's: greatest when sharpest (Subbarao,
    # Choi and Nikzad 1993).
    focus: float
    contrast_grey: float  # of the markers: 5th to 95th percentile, without slow variation of light
    saturated_part: float  # of the disc, at 250 grey levels or above

    @property
    def advice(self) -> str:
        """What to fix; empty if nothing."""
        if self.saturated_part > _SATURATED_PART:
            return "too bright: use less light or a shorter exposure"
        if self.contrast_grey < _CONTRAST_GREY:
            return "too flat: use more light, a longer exposure or a sharper lens"
        return ""


def find_pattern(grey: U8, stated: Disc | None = None) -> Pattern:
    """Find the disc, if it is not stated, and the pitch.

    Raises ConfigError if the image shows none.
    """
    if stated is not None:
        return Pattern(visible_disc(grey, stated), marker_pitch_px(grey, stated))
    scale = max(grey.shape[0] / _PATTERN_ROWS, 1.0)
    if min(grey.shape) < 16 * scale:
        raise ConfigError(
            "found no visible circle: the image is too small or too narrow "
            f"({grey.shape[1]}x{grey.shape[0]} px)"
        )
    small = cv2.resize(grey, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)
    disc = find_disc(np.asarray(small, np.uint8))
    # Pixel centres are whole numbers: resizing keeps the image's corners, not its first pixel.
    row_c, col_c = ((centre + 0.5) * scale - 0.5 for centre in (disc.row_c, disc.col_c))
    found = Disc(row_c, col_c, disc.radius_px * scale)
    return Pattern(found, marker_pitch_px(grey, found))


def view(grey: U8, pattern: Pattern) -> PatternView:
    """Measure how well an image shows the pattern of this image or an earlier one."""
    disc, (height, width) = pattern.disc, grey.shape
    inside = disc_mask(height, width, Disc(disc.row_c, disc.col_c, _INNER * disc.radius_px))
    if not inside.any():
        return PatternView(0.0, 0.0, 0.0)
    values = grey.astype(np.float32)
    # Less the mean over two pitches, because slow variation of light is no contrast.
    side = max(int(2 * pattern.pitch_px) | 1, 3)
    detail = (values - cv2.blur(values, (side, side)))[inside]
    fine = cv2.Laplacian(cv2.GaussianBlur(values, (0, 0), 1.0), cv2.CV_32F)[inside]
    low, high = np.percentile(detail, _PERCENTILES)
    return PatternView(
        focus=float(fine.std() / max(detail.std(), 1e-3)),
        contrast_grey=float(high - low),
        saturated_part=float(np.mean(grey[inside] >= SATURATED_LEVEL)),
    )
