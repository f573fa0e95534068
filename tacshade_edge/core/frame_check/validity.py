"""Check whether a frame can be used at all, before any solver sees it.

This runs on every frame, so each check starts with a cheap test that no bad frame passes: a count of pixels above a
limit instead of a median, blocks of rounded means instead of the pixels. Frames that fail it are checked in full.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from tacshade_edge.core.frame_check.blocks import (
    LIGHT_LOW,
    ROUNDED,
    BlockCheck,
    block_check,
    block_reasons,
    light_reason,
)
from tacshade_edge.core.frame_check.torn import TearCheck, tear_check, torn_reason
from tacshade_edge.core.geometry.disc import disc_mask
from tacshade_edge.core.image.median import percentile
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import U8, Bool, Calibration, Disc, frozen

# A working camera never shows a disc this dark or this flat (grey levels), or with half its reference's deviation.
BLACK_LEVEL = 12.0
FLAT_STD, FLAT_OVER_REFERENCE = 4.0, 0.5
SATURATED_LEVEL = 250
SATURATED_PART = 0.25
# Median difference of neighbouring pixels: flat places of the pattern keep it near the noise; for a finer pattern, the
# limit is relative to the reference's.
NOISE_STEP = 9.0
NOISE_OVER_REFERENCE = 5.0

# The brightest tenth of the disc, or less if less is bright, shows the amount of light.
BRIGHT_PART = 0.1

Box = tuple[slice, slice]


@frozen
class FrameCheck:
    """The properties of a good frame of one sensor.

    Attributes
    ----------
    shape : two ints
        Rows and columns of every frame.
    disc : two slices
        Pixels around the disc, starting at multiples of 8, with one to its left if the image has it.
    mask : uint8 (h, w)
        255 inside the disc, for the pixels `disc`.
    inside_px : int
        Number of pixels inside.
    pairs, sampled : uint8
        The mask for `_steps` and for `_sample` of a frame; `pairs_px` and `sampled_px` are the numbers of pixels.
    flat_std : float
        Deviation in grey levels below which a disc is black or flat.
    step : float
        Median difference of the reference's neighbouring pixels.
    saturated_part : float
        Part of the disc that may be saturated: the reference's plus `SATURATED_PART`, for images that arrive
        thresholded.
    bright_part : float
        Part of the disc that shows the light: half of the part above Otsu's level (1979), at most a tenth.
    bright : float
        Grey level that this part of the disc exceeds, at least 1.
    tear : TearCheck or None
        For an unloaded skin only: a pressed pattern along the camera's rows looks torn.
    blocks : BlockCheck or None
        None if no block lies inside the disc.
    camera_px : int
        Width of a pixel here in the camera's pixels, in which reasons are given.
    """

    shape: tuple[int, int]
    disc: Box
    mask: U8
    inside_px: int
    pairs: U8
    pairs_px: int
    sampled: U8
    sampled_px: int
    flat_std: float
    step: float
    saturated_part: float
    bright_part: float
    bright: float
    tear: TearCheck | None
    blocks: BlockCheck | None
    camera_px: int


def frame_check(
    reference_grey: U8, mask: Bool, disc: Disc, camera_px: int = 1, *, unloaded: bool = False
) -> FrameCheck:
    """Prepare the check from the mean reference image; `unloaded` if nothing touches the skin in the checked images."""
    box = _around(mask)
    reference, inside = reference_grey[box], np.where(mask[box], np.uint8(255), np.uint8(0))
    pairs, sampled = np.ascontiguousarray(inside[::8, 1:]), _sample(inside)
    bright_part = _bright_part(_sample(reference), sampled)
    return FrameCheck(
        shape=(mask.shape[0], mask.shape[1]),
        disc=box,
        mask=inside,
        inside_px=int(np.count_nonzero(inside)),
        pairs=pairs,
        sampled=sampled,
        sampled_px=int(np.count_nonzero(sampled)),
        pairs_px=int(np.count_nonzero(pairs)),
        flat_std=min(FLAT_STD, FLAT_OVER_REFERENCE * float(reference[inside > 0].std())) if mask.any() else FLAT_STD,
        step=_noise_step(reference, pairs),
        saturated_part=SATURATED_PART + (float(np.mean(reference[inside > 0] >= SATURATED_LEVEL)) if mask.any() else 0),
        bright_part=bright_part,
        bright=max(_bright(_sample(reference), sampled, bright_part), 1.0),
        tear=tear_check(reference_grey, mask) if unloaded else None,
        blocks=block_check(reference_grey, disc, camera_px),
        camera_px=camera_px,
    )


def sensor_check(calibration: Calibration, camera_px: int = 1, *, unloaded: bool = False) -> FrameCheck:
    """`frame_check` with a calibration's reference."""
    disc = calibration.geometry.disc
    mask = disc_mask(calibration.image_height_px, calibration.image_width_px, disc)
    return frame_check(calibration.reference_grey, mask, disc, camera_px, unloaded=unloaded)


def _around(mask: Bool) -> Box:
    """Pixels around a mask and left of it, starting at multiples of 8 so that `_steps` and `_sample` stay aligned."""
    rows, cols = (np.flatnonzero(mask.any(axis=axis)).tolist() or [0, -1] for axis in (1, 0))
    return slice(rows[0] // 8 * 8, rows[-1] + 1), slice(max(cols[0] - 1, 0) // 8 * 8, cols[-1] + 1)


def invalid_reason(grey: U8, check: FrameCheck) -> Reason | None:
    """Why a frame cannot be used; None if it can.

    Parameters
    ----------
    grey : uint8 (H, W)
    check : FrameCheck
    """
    return size_reason(grey, check.shape) or picture_reason(grey, check)


def picture_reason(grey: U8, check: FrameCheck) -> Reason | None:
    """`invalid_reason` of an image of the right size."""
    if check.inside_px == 0:
        return Reason(ReasonCode.NO_DISC, "disc: no pixel of the visible circle lies in the image")
    disc = grey[check.disc]
    if reason := _camera_reason(disc, check):
        return reason
    return _compared_reason(grey, disc, check.blocks, check) if check.blocks else None


def size_reason(image: U8, shape: tuple[int, int]) -> Reason | None:
    """Reason that an image, (H, W) or (H, W, 3), lacks the calibrated size; None if it has it."""
    if image.shape[:2] == shape:
        return None
    text = f"size: found {image.shape[1]}x{image.shape[0]} px, expected the calibration's {shape[1]}x{shape[0]} px"
    return Reason(ReasonCode.SIZE, text)


def _camera_reason(disc: U8, check: FrameCheck) -> Reason | None:
    """Reason from the disc's pixels alone: saturated, black, flat or noise; None if none."""
    pixels = check.inside_px
    mean, square = (cv2.norm(disc, kind, check.mask) / pixels for kind in (cv2.NORM_L1, cv2.NORM_L2SQR))
    if square > check.saturated_part * SATURATED_LEVEL**2:  # that many saturated pixels alone exceed this
        bright = _count_from(disc, check.mask, SATURATED_LEVEL)
        if bright > check.saturated_part * pixels:
            text = f"saturated: {100 * bright / pixels:.0f} % of the disc is at grey level {SATURATED_LEVEL} or above"
            return Reason(ReasonCode.SATURATED, text)
    std = math.sqrt(max(square - mean * mean, 0))
    if std < check.flat_std:
        figures = f"mean grey level {mean:.0f}, standard deviation {std:.1f}"
        if mean < BLACK_LEVEL:
            return Reason(ReasonCode.BLACK, f"black: {figures}")
        return Reason(ReasonCode.NO_CONTRAST, f"no contrast: {figures}")
    most = max(NOISE_STEP, check.step + NOISE_OVER_REFERENCE)
    if check.pairs_px and 2 * _count_from(_steps(disc), check.pairs, most) >= check.pairs_px:
        step = _noise_step(disc, check.pairs)
        if step > most:
            return Reason(ReasonCode.NOISE, f"noise: neighbouring pixels differ by {step:.0f} grey levels")
    return None


def _count_from(grey: U8, mask: U8, level: float) -> int:
    """The number of pixels in a mask (255 inside) at or above a level."""
    bright = cv2.threshold(grey, math.ceil(level) - 1, 255, cv2.THRESH_BINARY)[1]
    return cv2.countNonZero(cv2.bitwise_and(bright, mask))


def _steps(disc: U8) -> U8:
    """Differences of horizontal neighbours on every eighth row."""
    rows = disc[::8]
    return np.asarray(cv2.absdiff(rows[:, 1:], rows[:, :-1]), np.uint8)


def _noise_step(disc: U8, pairs: U8) -> float:
    """Median difference of horizontal neighbours in the disc."""
    return float(np.median(_steps(disc)[pairs > 0])) if pairs.any() else 0.0


def _sample(disc: U8) -> U8:
    """Every fourth pixel in both directions."""
    return np.ascontiguousarray(disc[::4, ::4])


def _bright_part(sample: U8, sampled: U8) -> float:
    """Half of the part of the disc above Otsu's level, at most a tenth: pins may cover a twentieth of it."""
    inside = sample[sampled > 0].reshape(-1, 1)
    if not inside.size:
        return BRIGHT_PART
    split, _ = cv2.threshold(inside, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    return min(float(np.mean(inside > split)) / 2, BRIGHT_PART)


def _bright(sample: U8, sampled: U8, part: float) -> float:
    """Grey level that a part of the disc exceeds."""
    return percentile(sample[sampled > 0], 100 * (1 - part)) if sampled.any() else 0.0


def _compared_reason(grey: U8, disc: U8, blocks: BlockCheck, check: FrameCheck) -> Reason | None:
    """Reason by comparison with the reference: torn, shifted or other light; None if none."""
    dark = _dark_reason(disc, check)
    torn = torn_reason(grey, check.tear, check.camera_px)
    if not blocks.textured_at.size:
        return torn
    for rounded in (ROUNDED, 0):
        lost, changed = block_reasons(grey, blocks, rounded)
        if not lost and not changed:
            break
    return lost or torn or dark or changed


def _dark_reason(disc: U8, check: FrameCheck) -> Reason | None:
    # A deep contact darkens or brightens most of the disc, but some markers stay as bright as the light, and show when
    # it falls. More light saturates them; then the common level shows it.
    sample, sampled = _sample(disc), check.sampled
    if _count_from(sample, sampled, LIGHT_LOW * check.bright) >= check.bright_part * check.sampled_px + 2:
        return None
    gain = _bright(sample, sampled, check.bright_part) / check.bright
    return light_reason(gain) if gain < LIGHT_LOW else None
