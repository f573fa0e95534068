"""Judge the camera's place.

In a frame that is by what lies around the disc. References and presses measure the drift of the
pattern's part that moves as one piece: a coarse shift by phase correlation (Kuglin and Hines 1975),
points tracked from there (Lucas and Kanade 1981), and the similarity that most of them follow
(RANSAC).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.frame_check.picture import (
    LIGHT_HIGH,
    LIGHT_LOW,
    Measured,
    light_drift_reason,
)
from tacshade_edge.sensor.image.white import eighth, median
from tacshade_edge.types import F32, F64, U8, Disc, frozen

# What lies between these radii around the disc changes only with the light; from the first on,
# because a soft tip that sways carries its markers past the edge.
SURROUND_FROM, SURROUND_TO = 1.1, 1.35
# A block of it has changed by this many levels and a quarter of its light; this part of them is
# another surround. Real frames show 0.008, simulated moves and specks 0.05; torn and foreign ones
# 0.10 and more.
SURROUND_LEVELS, SURROUND_PART = 25.0, 0.08
# Darker blocks do not show the amount of light; a thresholded image has many.
LIT_LEVEL = 4.0
# One pixel along both axes (1.4) passes: it changes depths by a few per cent. Further than the
# last, a shift is only another surround.
LEAST_PX, MOST_PX = 1.8, 8
# Fewer blocks, or ones that a shift by a pixel changes by less (RMS, levels), show no shift; the
# best shift leaves at most this part of the squared change, or it explains nothing.
LEAST_BLOCKS, LEAST_SLOPE, LEFT_PART = 40, 1.0, 0.5
# Pitch of the lattice of tracked points, the part of the disc that holds them,
# and the window of each, in pitches.
_POINT_PITCHES, _RHO_MAX, _WINDOW_PITCHES = 1.0, 0.95, 2.0
_LEAST_WINDOW_PX = 7
# A point's search ends after so many steps, or when a step is shorter than this.
_TRACK_STEPS, _TRACK_PX = 30, 0.01
_RANSAC_TURNS, _RANSAC_CONFIDENCE = 2000, 0.999
# A point belongs to the piece if it lies this near to its place by the common motion.
_INLIER_PX = 0.5
_MAD = 1.4826  # a Gaussian's standard deviation over its median absolute deviation
# Fewer points, or a smaller part of all, measure nothing.
_LEAST_POINTS, _LEAST_PART = 20, 0.2
# Beyond this part of the disc's radius the geometry is wrong; a smaller shift of the centre, or
# movement with turn and zoom (of which a deep press alone imitates 1 px), is worth a warning.
SHIFTED_PART = 0.02
SHIFT_PART, RIM_PART = 0.0035, 0.012
# A camera's movement carries all of the pattern along, but for this part, which is badly tracked;
# where a point lies nearer to the centre than this part of the radius, a turn does not show.
_UNTRUE_PART, _TURNING_PART = 0.1, 0.3
# A smaller turn or zoom is not worth a word beside the shift.
_TOLD_DEG, _TOLD_ZOOM = 0.2, 0.005


class CameraJudge:
    """Judges what lies around the disc by the mean reference; `camera_px` as in `Judges`."""

    def __init__(self, reference_grey: U8, disc: Disc, camera_px: int = 1) -> None:
        usual = eighth(reference_grey)
        rows, cols = (np.arange(size) * 8 + 3.5 for size in usual.shape)
        r = np.hypot(rows[:, None] - disc.row_c, cols[None, :] - disc.col_c)
        around = (r > SURROUND_FROM * disc.radius_px + 6) & (r < SURROUND_TO * disc.radius_px)
        self._at = np.flatnonzero(around)
        self._usual: F32 = usual.take(self._at).astype(np.float32)
        self._lit = np.flatnonzero(self._usual >= LIT_LEVEL)
        self._camera_px, self._step_px = camera_px, max(camera_px, 2)
        step, reach = self._step_px // camera_px, MOST_PX // camera_px
        self._side = 2 * reach // step + 1
        wide = np.pad(reference_grey, reach, mode="edge")
        height, width = reference_grey.shape
        offsets = range(2 * reach, -1, -step)  # the first shift moves the picture up and left
        shifted = np.stack(
            [
                eighth(wide[r : r + height, c : c + width]).take(self._at)
                for r in offsets
                for c in offsets
            ]
        )
        # Each shift in a light that may fall more on one side:
        # 1, and the row and the column, times the picture.
        plane = np.stack(np.broadcast_arrays(1.0, rows[:, None] - disc.row_c, cols - disc.col_c))
        plane = plane.reshape(3, -1)[:, self._at] / np.array(
            [[1.0], [disc.radius_px], [disc.radius_px]]
        )
        self._lights: F32 = (shifted[:, None] * plane).astype(np.float32)  # (shifts, 3, blocks)
        self._from_lights = np.linalg.pinv(
            self._lights @ self._lights.transpose(0, 2, 1), hermitian=True
        )
        middle = len(shifted) // 2
        slopes = (
            shifted[middle + k].astype(np.float32) - shifted[middle - k] for k in (1, self._side)
        )
        slope = (
            min(float(np.sqrt(np.mean(each**2))) for each in slopes)
            if self._usual.size >= LEAST_BLOCKS
            else 0.0
        )
        self._slope = slope / (2 * self._step_px)

    def measured(self, eighths: U8) -> tuple[Measured, ...]:
        """What is measured of an image's means over 8x8 px."""
        if not self._usual.size:
            return ()
        shift_px, part = self._found(eighths)
        moved = f"the camera has moved by {shift_px:.1f} px since the reference was taken"
        other = (
            f"torn or moved: {100 * part:.0f} % of the image around the disc differs from the "
            "reference"
        )
        return (
            Measured(
                "camera", "shift, px", shift_px, 0, LEAST_PX, Reason(ReasonCode.CAMERA_SHIFT, moved)
            ),
            Measured(
                "camera",
                "other surround",
                part,
                0,
                SURROUND_PART,
                Reason(ReasonCode.SURROUND, other),
            ),
        )

    def passes(self, eighths: U8) -> bool:
        """Whether an image passes, without a sentence for what it would be refused for."""
        shift_px, part = self._found(eighths) if self._usual.size else (0.0, 0.0)
        return shift_px <= LEAST_PX and part <= SURROUND_PART

    def _found(self, eighths: U8) -> tuple[float, float]:
        """How far the camera moved, in its pixels, and the part of the surround that differs."""
        found = eighths.take(self._at).astype(np.float32)
        # Use the surround's own light, because a contact changes the brightness of the whole disc.
        lit = self._lit
        light = median(found[lit] / self._usual[lit]) if lit.size else 1.0
        light = min(max(light, LIGHT_LOW), LIGHT_HIGH)
        expected = np.minimum(np.float32(light) * self._usual, np.float32(255))
        changed = np.abs(found - expected)
        part = np.count_nonzero(changed > SURROUND_LEVELS + 0.25 * expected) / found.size
        return self._shift_px(found), part

    def _shift_px(self, found: F32) -> float:
        """The shift that explains the change of what lies around, in the camera's pixels;
        0 if none does.
        """
        if self._slope < LEAST_SLOPE:
            return 0.0
        middle, of_a_px = self._side // 2, found.size * self._slope**2
        here = (self._side + 1) * middle
        seen = self._lights[here] @ found
        if found @ found - seen @ self._from_lights[here] @ seen <= of_a_px:
            return 0.0  # too little changed for a shift that counts, and this is every good frame
        seen = self._lights @ found
        explained = np.einsum("ki,kij,kj->k", seen, self._from_lights, seen)
        left = (found @ found - explained).reshape(self._side, self._side)
        row, col = divmod(int(left.argmin()), self._side)
        least = max(LEFT_PART * float(left[middle, middle]), of_a_px)
        if left[row, col] > least:
            return 0.0
        shift = (row - middle + _vertex(left[:, col], row), col - middle + _vertex(left[row], col))
        return self._step_px * math.hypot(*shift)


def _vertex(values: F32, at: int) -> float:
    """Where the parabola through the least value and its neighbours is least,
    -0.5 to 0.5 beside it.
    """
    if not 0 < at < len(values) - 1:
        return 0.0
    before, here, after = (float(value) for value in values[at - 1 : at + 2])
    bend = before - 2 * here + after
    return 0.5 * (before - after) / bend if bend > 0 else 0.0


@frozen
class CameraLook:
    """A reference, prepared for comparison: tracked points (col, row) (N, 2), local mean and
    deviation of the grey (H, W).
    """

    grey: U8
    disc: Disc
    pitch_px: float
    points: F32
    level: F32
    contrast: F32


@dataclass(frozen=True, slots=True)
class Drift:
    """The change of an image since the reference."""

    # Part of the pattern that moved as one piece; if 0, nothing was measured: all is neutral.
    still_part: float = 0.0
    moved_px: float = (
        0.0  # greatest movement of a point of the visible circle by shift, turn and zoom together
    )
    # What the movement has at least, since a contact leaves some of the skin in place: that of the
    # part that moved least, as a shift, or a turn or zoom of the visible circle.
    carried_px: float = 0.0
    row_px: float = 0.0  # shift of the circle's centre
    col_px: float = 0.0
    turn_deg: float = 0.0
    zoom: float = 1.0
    light: float = 1.0  # ratio of the brightness to the reference's
    uneven: float = 0.0  # standard deviation of its logarithm over the disc
    # Ratio of the contrast to the reference's, beyond the effect of the light: below 1 is blur.
    contrast: float = 1.0

    @property
    def shift_px(self) -> float:
        """Distance that the centre of the visible circle moved, px."""
        return math.hypot(self.row_px, self.col_px)

    @property
    def light_reason(self) -> Reason | None:
        """Reason that light or focus changed; None if the change is small enough
        to be compensated.
        """
        return light_drift_reason(self.light, self.uneven, self.contrast)


def look(grey: U8, disc: Disc, pitch_px: float) -> CameraLook:
    """Prepare a reference. `grey`: uint8 (H, W). `pitch_px`: marker pitch."""
    height, width = grey.shape
    reach, step = (
        _RHO_MAX * disc.radius_px - _WINDOW_PITCHES * pitch_px / 2,
        max(_POINT_PITCHES * pitch_px, 2.0),
    )
    offsets = np.arange(-reach, reach + 1e-6, step)
    cols, rows = np.meshgrid(disc.col_c + offsets, disc.row_c + offsets)
    near = np.hypot(cols - disc.col_c, rows - disc.row_c) <= reach
    near &= (cols >= 0) & (cols <= width - 1) & (rows >= 0) & (rows <= height - 1)
    points = np.stack([cols[near], rows[near]], axis=1).astype(np.float32)
    return CameraLook(grey, disc, pitch_px, points, *_statistics(grey, pitch_px))


def drift(reference: CameraLook, grey: U8) -> Drift:
    """Compare an image with a reference, with or without contact.

    `grey`: uint8 (H, W), of the reference's size.
    """
    if len(reference.points) < _LEAST_POINTS or grey.shape != reference.grey.shape:
        return Drift()
    before, after = tracked(reference, grey)
    if len(before) < _LEAST_POINTS:
        return Drift()
    matrix, inliers = cv2.estimateAffinePartial2D(
        before,
        after,
        method=cv2.RANSAC,
        ransacReprojThreshold=_INLIER_PX,
        maxIters=_RANSAC_TURNS,
        confidence=_RANSAC_CONFIDENCE,
    )
    if matrix is None:
        return Drift()
    still = inliers.ravel() > 0
    # Of all points, not of those tracked: a contact that hides half the pattern leaves half of it.
    part = float(np.count_nonzero(still) / len(reference.points))
    if np.count_nonzero(still) < _LEAST_POINTS or part < _LEAST_PART:
        return Drift()
    light, uneven, contrast = _light(reference, grey, before[still], after[still])
    return replace(
        _movement(matrix, reference.disc),
        still_part=part,
        carried_px=_carried_px(before, after, reference.disc),
        light=light,
        uneven=uneven,
        contrast=contrast,
    )


def tracked(reference: CameraLook, grey: U8) -> tuple[F32, F32]:
    """The reference's points that are found in an image, there and here, (N, 2) each."""
    start = reference.points + _coarse_shift(reference, grey)
    side = _window_px(reference.pitch_px)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        reference.grey,
        grey,
        reference.points[:, None],
        start[:, None].copy(),  # OpenCV writes into it, and refuses a view
        winSize=(side, side),
        # No pyramid: the coarse shift leaves less than a pitch, and coarser pictures lose the pins.
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _TRACK_STEPS, _TRACK_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    tracked = status.ravel() > 0
    return reference.points[tracked], found[:, 0][tracked]


def _carried_px(before: F32, after: F32, disc: Disc) -> float:
    """How far points (N, 2), (col, row), moved at least, seen as a shift or a turn of the disc."""
    away_px = np.hypot(*(before - np.array((disc.col_c, disc.row_c))).T)
    far = away_px > _TURNING_PART * disc.radius_px
    moved_px = np.hypot(*(after - before)[far].T)
    at_rim_px = moved_px * disc.radius_px / away_px[far]
    return float(np.quantile(at_rim_px, _UNTRUE_PART)) if at_rim_px.size else 0.0


def _movement(matrix: F64, disc: Disc) -> Drift:
    """What a similarity (2, 3) of (col, row), turn and zoom in its left part, does to the disc."""
    centre = np.array([disc.col_c, disc.row_c])
    col_px, row_px = matrix[:, :2] @ centre + matrix[:, 2] - centre
    # About its own centre, the rim moves by |s e^(iφ) - 1| of the radius.
    rim = disc.radius_px * math.hypot(matrix[0, 0] - 1, matrix[1, 0])
    return Drift(
        moved_px=math.hypot(row_px, col_px) + rim,
        row_px=float(row_px),
        col_px=float(col_px),
        turn_deg=math.degrees(math.atan2(matrix[1, 0], matrix[0, 0])),
        zoom=math.hypot(matrix[0, 0], matrix[1, 0]),
    )


def shift_reason(found: Drift, disc: Disc) -> Reason | None:
    """Reason that the camera moved relative to the skin; None if no movement was measured."""
    if (
        found.shift_px <= SHIFT_PART * disc.radius_px
        and found.moved_px <= RIM_PART * disc.radius_px
    ):
        return None
    turned = f", turned by {found.turn_deg:.2f} degrees" if abs(found.turn_deg) > _TOLD_DEG else ""
    zoomed = (
        f", scaled by {100 * (found.zoom - 1):+.1f} %" if abs(found.zoom - 1) > _TOLD_ZOOM else ""
    )
    return Reason(
        ReasonCode.CAMERA_SHIFT, f"the image moved by {found.shift_px:.1f} px{turned}{zoomed}"
    )


def shifted_too_far(found: Drift, disc: Disc) -> bool:
    """Whether the visible circle is too far from its calibrated place."""
    return found.moved_px > SHIFTED_PART * disc.radius_px


def carried_too_far(found: Drift, disc: Disc) -> bool:
    """The same for an image of a contact."""
    return min(found.moved_px, found.carried_px) > SHIFTED_PART * disc.radius_px


def carries_pattern(found: Drift, disc: Disc) -> bool:
    """Whether all of the pattern moved further than a shift that counts: by a contact, some of the
    skin stays in place, however much of a soft gel moves with the object.
    """
    return found.carried_px > SHIFT_PART * disc.radius_px


def _window_px(pitch_px: float) -> int:
    """Side of the window around a point, odd as OpenCV's boxes must be to have a middle."""
    return max(int(_WINDOW_PITCHES * pitch_px) | 1, _LEAST_WINDOW_PX)


def _statistics(grey: U8, pitch_px: float) -> tuple[F32, F32]:
    """Local mean and standard deviation at each pixel, over whole markers."""
    side = _window_px(pitch_px)
    values = grey.astype(np.float32)
    mean = cv2.blur(values, (side, side))
    square = cv2.blur(values * values, (side, side))
    return mean, np.sqrt(np.maximum(square - mean * mean, 0))


def _coarse_shift(reference: CameraLook, grey: U8) -> F32:
    """Column and row shift of the whole disc, to a fraction of a pitch, px: print errors
    distinguish whole pitches.
    """
    disc, side = reference.disc, int(1.2 * reference.disc.radius_px)
    top, left = max(round(disc.row_c) - side, 0), max(round(disc.col_c) - side, 0)
    cut = (slice(top, round(disc.row_c) + side), slice(left, round(disc.col_c) + side))
    first, second = (image[cut].astype(np.float32) for image in (reference.grey, grey))
    window = cv2.createHanningWindow((first.shape[1], first.shape[0]), cv2.CV_32F)
    (col, row), _ = cv2.phaseCorrelate(first - first.mean(), second - second.mean(), window)
    return np.array([col, row], dtype=np.float32)


def _light(reference: CameraLook, grey: U8, before: F32, after: F32) -> tuple[float, float, float]:
    """Ratio of light, its unevenness, and ratio of contrast to the reference's,
    where the pattern stood still.
    """
    level, contrast = _statistics(grey, reference.pitch_px)
    old, new = (tuple(np.rint(points).astype(int).T[::-1]) for points in (before, after))
    height, width = grey.shape
    inside = (new[0] >= 0) & (new[0] < height) & (new[1] >= 0) & (new[1] < width)
    old, new = (tuple(axis[inside] for axis in place) for place in (old, new))
    ratio = np.log(np.maximum(level[new], 1) / np.maximum(reference.level[old], 1))
    sharp = np.log(np.maximum(contrast[new], 0.5) / np.maximum(reference.contrast[old], 0.5))
    light = float(np.median(ratio))
    uneven = _MAD * float(np.median(np.abs(ratio - light)))
    return math.exp(light), uneven, math.exp(float(np.median(sharp - ratio)))
