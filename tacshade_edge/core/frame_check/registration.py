"""Measure a sensor's drift from its reference image: a moved camera, other light, a blurred lens.

References, presses, new references and `doctor` share this measure. It uses the part of the pattern that moves as one
piece, so a press, which moves only some of it, does not count as drift: a coarse shift by phase correlation (Kuglin and
Hines 1975), points tracked from there (Lucas and Kanade 1981), and the similarity that most of them follow (RANSAC,
Fischler and Bolles 1981).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import F32, U8, Disc, frozen

# Pitch of the lattice of tracked points, the part of the disc that holds them, and the window of each, in pitches.
_POINT_PITCHES, _RHO_MAX, _WINDOW_PITCHES = 1.0, 0.95, 2.0
# A point belongs to the piece if it lies this near to its place by the common motion.
_INLIER_PX = 0.5
# Fewer points, or a smaller part of all, measure nothing.
_LEAST_POINTS, _LEAST_PART = 20, 0.2
# Beyond this part of the disc's radius the geometry is wrong; a smaller shift of the centre, or movement with turn and
# zoom (of which a deep press alone imitates 1 px), is worth a warning.
SHIFTED_PART = 0.02
SHIFT_PART, RIM_PART = 0.0035, 0.012
# Range of light that is compensated, and limits of unevenness and blur beyond all good presses (calibration-checks.md).
LIGHT_LOW, LIGHT_HIGH, UNEVEN, CONTRAST = 0.8, 1.25, 0.08, 0.8


@frozen
class Look:
    """The appearance of a sensor, prepared for comparison.

    Attributes
    ----------
    grey : uint8 (H, W)
    disc : Disc
    pitch_px : float
    points : float32 (N, 2)
        Column and row of the tracked points.
    level, contrast : float32 (H, W)
        Local mean and standard deviation of the grey at each pixel.
    """

    grey: U8
    disc: Disc
    pitch_px: float
    points: F32
    level: F32
    contrast: F32


@dataclass(frozen=True, slots=True)
class Drift:
    """The change of an image since the reference.

    Attributes
    ----------
    still_part : float
        Part of the pattern that moved as one piece, 0 to 1; if 0, nothing was measured and all else is neutral.
    moved_px : float
        Greatest movement of a point of the visible circle by shift, turn and zoom together.
    row_px, col_px : float
        Shift of the circle's centre.
    turn_deg, zoom : float
    light : float
        Ratio of the brightness to the reference's.
    uneven : float
        Standard deviation of the ratio's logarithm over the disc.
    contrast : float
        Ratio of the contrast to the reference's, beyond the effect of the light: below 1 is blur.
    """

    still_part: float = 0.0
    moved_px: float = 0.0
    row_px: float = 0.0
    col_px: float = 0.0
    turn_deg: float = 0.0
    zoom: float = 1.0
    light: float = 1.0
    uneven: float = 0.0
    contrast: float = 1.0

    @property
    def shift_px(self) -> float:
        """Distance that the centre of the visible circle moved, px."""
        return math.hypot(self.row_px, self.col_px)


def look(grey: U8, disc: Disc, pitch_px: float) -> Look:
    """Prepare a reference.

    Parameters
    ----------
    grey : uint8 (H, W)
    disc : Disc
    pitch_px : float
        Marker pitch.
    """
    height, width = grey.shape
    reach, step = _RHO_MAX * disc.radius_px - _WINDOW_PITCHES * pitch_px / 2, max(_POINT_PITCHES * pitch_px, 2.0)
    offsets = np.arange(-reach, reach + 1e-6, step)
    cols, rows = np.meshgrid(disc.col_c + offsets, disc.row_c + offsets)
    near = np.hypot(cols - disc.col_c, rows - disc.row_c) <= reach
    near &= (cols >= 0) & (cols <= width - 1) & (rows >= 0) & (rows <= height - 1)
    points = np.stack([cols[near], rows[near]], axis=1).astype(np.float32)
    return Look(grey, disc, pitch_px, points, *_statistics(grey, pitch_px))


def drift(reference: Look, grey: U8) -> Drift:
    """Compare an image with a reference, with or without contact.

    Parameters
    ----------
    reference : Look
    grey : uint8 (H, W)
        Image of the reference's size.
    """
    if len(reference.points) < _LEAST_POINTS or grey.shape != reference.grey.shape:
        return Drift()
    start = reference.points + _coarse_shift(reference, grey)
    side = max(int(_WINDOW_PITCHES * reference.pitch_px) | 1, 7)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        reference.grey,
        grey,
        reference.points[:, None],
        start[:, None].copy(),
        winSize=(side, side),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    tracked = status.ravel() > 0
    if np.count_nonzero(tracked) < _LEAST_POINTS:
        return Drift()
    before, after = reference.points[tracked], found[:, 0][tracked]
    matrix, inliers = cv2.estimateAffinePartial2D(
        before, after, method=cv2.RANSAC, ransacReprojThreshold=_INLIER_PX, maxIters=2000, confidence=0.999
    )
    if matrix is None:
        return Drift()
    still = inliers.ravel() > 0
    part = float(np.count_nonzero(still) / len(reference.points))
    if np.count_nonzero(still) < _LEAST_POINTS or part < _LEAST_PART:
        return Drift()
    disc = reference.disc
    centre = np.array([disc.col_c, disc.row_c])
    col_px, row_px = matrix[:, :2] @ centre + matrix[:, 2] - centre
    scale = math.hypot(matrix[0, 0], matrix[1, 0])
    rim = disc.radius_px * math.hypot(matrix[0, 0] - 1, matrix[1, 0])
    light, uneven, contrast = _light(reference, grey, before[still], after[still])
    return Drift(
        still_part=part,
        moved_px=math.hypot(row_px, col_px) + rim,
        row_px=float(row_px),
        col_px=float(col_px),
        turn_deg=math.degrees(math.atan2(matrix[1, 0], matrix[0, 0])),
        zoom=scale,
        light=light,
        uneven=uneven,
        contrast=contrast,
    )


def shift_reason(found: Drift, disc: Disc) -> Reason | None:
    """Reason that the camera moved relative to the skin; None if no movement was measured."""
    if found.shift_px <= SHIFT_PART * disc.radius_px and found.moved_px <= RIM_PART * disc.radius_px:
        return None
    turned = f", turned by {found.turn_deg:.2f} degrees" if abs(found.turn_deg) > 0.2 else ""
    zoomed = f", scaled by {100 * (found.zoom - 1):+.1f} %" if abs(found.zoom - 1) > 0.005 else ""
    return Reason(ReasonCode.CAMERA_SHIFT, f"the image moved by {found.shift_px:.1f} px{turned}{zoomed}")


def shifted_too_far(found: Drift, disc: Disc) -> bool:
    """Whether the visible circle is too far from its calibrated place."""
    return found.moved_px > SHIFTED_PART * disc.radius_px


def light_drift_reason(found: Drift) -> Reason | None:
    """Reason that light or focus changed; None if the change is small enough to be compensated."""
    changes = []
    if not LIGHT_LOW <= found.light <= LIGHT_HIGH:
        changes.append(f"{found.light:.2f} times the light")
    if found.uneven > UNEVEN:
        changes.append(f"the light falls differently (it varies by {100 * found.uneven:.0f} % over the disc)")
    if found.contrast < CONTRAST:
        changes.append(f"blurred or dirty ({found.contrast:.2f} times the contrast)")
    return Reason(ReasonCode.LIGHT_DRIFT, ", ".join(changes)) if changes else None


def _statistics(grey: U8, pitch_px: float) -> tuple[F32, F32]:
    """Local mean and standard deviation at each pixel, over whole markers."""
    side = max(int(_WINDOW_PITCHES * pitch_px) | 1, 7)
    values = grey.astype(np.float32)
    mean = cv2.blur(values, (side, side))
    square = cv2.blur(values * values, (side, side))
    return mean, np.sqrt(np.maximum(square - mean * mean, 0))


def _coarse_shift(reference: Look, grey: U8) -> F32:
    """Column and row shift of the whole disc, to a fraction of a pitch, px: print errors distinguish whole pitches."""
    disc, side = reference.disc, int(1.2 * reference.disc.radius_px)
    top, left = max(round(disc.row_c) - side, 0), max(round(disc.col_c) - side, 0)
    cut = (slice(top, round(disc.row_c) + side), slice(left, round(disc.col_c) + side))
    first, second = (image[cut].astype(np.float32) for image in (reference.grey, grey))
    window = cv2.createHanningWindow((first.shape[1], first.shape[0]), cv2.CV_32F)
    (col, row), _ = cv2.phaseCorrelate(first - first.mean(), second - second.mean(), window)
    return np.array([col, row], dtype=np.float32)


def _light(reference: Look, grey: U8, before: F32, after: F32) -> tuple[float, float, float]:
    """Ratio of light, its unevenness, and ratio of contrast to the reference's, where the pattern stood still."""
    level, contrast = _statistics(grey, reference.pitch_px)
    old, new = (tuple(np.rint(points).astype(int).T[::-1]) for points in (before, after))
    height, width = grey.shape
    inside = (new[0] >= 0) & (new[0] < height) & (new[1] >= 0) & (new[1] < width)
    old, new = (tuple(axis[inside] for axis in place) for place in (old, new))
    ratio = np.log(np.maximum(level[new], 1) / np.maximum(reference.level[old], 1))
    sharp = np.log(np.maximum(contrast[new], 0.5) / np.maximum(reference.contrast[old], 0.5))
    light = float(np.median(ratio))
    uneven = 1.4826 * float(np.median(np.abs(ratio - light)))
    return math.exp(light), uneven, math.exp(float(np.median(sharp - ratio)))
