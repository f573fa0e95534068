"""Find specular spots that the reference does not have: they and their halo hide the skin."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.core.image.binarise import padded
from tacshade_edge.core.image.median import percentile
from tacshade_edge.types import U8, freeze

# Every box of this many pitches holds part of a black pin, in contact too (measured: 0.9 is enough), except under
# glare, where its darkest pixel exceeds the reference's by GLARE_LIFT and by GLARE_PART of the reference's range from
# dark to bright; another exposure lifts the dark less.
GLARE_PITCHES = 1.0
GLARE_LIFT, GLARE_PART = 22, 0.2
# Pixels are also glare if brighter than GLARE_GAIN times the brightest marker nearby in the reference plus
# GLARE_OFFSET; a drag moves markers by up to GLARE_REACH pitches to where the reference has none.
GLARE_GAIN, GLARE_OFFSET, GLARE_REACH = 1.3, 25, 2.0
GLARE_PX = 6
# Width of the halo around a glare spot that is not trusted either, in pitches (plus a block).
GLARE_HALO_PITCHES = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class GlareCheck:
    """The appearance of a sensor without glare, inside the window of its disc.

    Attributes
    ----------
    inside : uint8 (H / block_px, W / block_px)
        255 for blocks with pixels of the disc.
    block_px : int
        Side of the blocks of the search: at most a quarter of the pitch, and at most 4.
    darkest : uint8 (H / block_px, W / block_px)
        Upper limit for the darkest pixel around each block.
    brightest : uint8 (H, W)
        Upper limit for each pixel: 255 outside the disc, where glare does not matter.
    box, halo : uint8 (n, n)
        Neighbourhoods of blocks, as morphological kernels.
    whole, bright : uint8
        Work space: `whole` has whole blocks, white beyond the window; `bright` has the size of the window.
    """

    inside: U8
    block_px: int
    darkest: U8
    brightest: U8
    box: U8
    halo: U8
    whole: U8
    bright: U8

    def __post_init__(self) -> None:
        freeze(self, "inside", "darkest", "brightest", "box", "halo")


def glare_check(reference_grey: U8, mask: U8, pitch_px: float) -> GlareCheck:
    """Prepare the search for glare from the mean reference image and the disc's mask (0 or 1), both of the window."""
    block_px = next(side for side in (4, 2, 1) if side == 1 or side <= pitch_px / 4)
    box = _around(GLARE_PITCHES * pitch_px, block_px)
    halo = _around(2 * (GLARE_HALO_PITCHES * pitch_px + block_px), block_px)
    marked = cv2.multiply(reference_grey, mask)
    reach = np.ones((2 * round(GLARE_REACH * pitch_px) + 1,) * 2, np.uint8)
    lifted = cv2.erode(_least(reference_grey, block_px), box) + np.uint16(_lift(reference_grey, mask))
    brightest = cv2.convertScaleAbs(cv2.dilate(marked, reach), alpha=GLARE_GAIN, beta=GLARE_OFFSET)
    return GlareCheck(
        inside=_most(np.multiply(mask, 255, dtype=np.uint8), block_px),
        block_px=block_px,
        darkest=np.minimum(lifted, 255).astype(np.uint8),
        brightest=np.where(mask > 0, brightest, np.uint8(255)),
        box=box,
        halo=halo,
        whole=padded(np.full_like(mask, 255), block_px, 255),
        bright=np.empty_like(mask),
    )


def glare_mask(grey: U8, check: GlareCheck) -> U8 | None:
    """Find the pixels in and around specular spots that the reference does not have.

    Parameters
    ----------
    grey : uint8 (H, W)
        Grey image of the window.
    check : GlareCheck

    Returns
    -------
    uint8 (H, W) or None
        1 in glare and its halo, in whole blocks; None without glare.
    """
    side, (rows, cols) = check.block_px, grey.shape
    check.whole[:rows, :cols] = grey
    found = cv2.compare(cv2.erode(_least(check.whole, side), check.box), check.darkest, cv2.CMP_GT)
    bright = cv2.compare(grey, check.brightest, cv2.CMP_GT, dst=check.bright)
    some = cv2.countNonZero(bright) >= GLARE_PX
    if not some and cv2.countNonZero(found) == 0:
        return None
    if some:
        found = cv2.bitwise_or(found, _most(bright, side))
    found = cv2.bitwise_and(found, check.inside)
    if cv2.countNonZero(found) == 0:
        return None
    grown = np.minimum(cv2.dilate(found, check.halo), 1)
    return np.ascontiguousarray(grown.repeat(side, axis=0).repeat(side, axis=1)[:rows, :cols])


def _lift(reference_grey: U8, mask: U8) -> int:
    """The number of grey levels by which glare lifts the reference's dark pixels."""
    inside = reference_grey[mask > 0]
    if not inside.size:
        return GLARE_LIFT
    dark, bright = (percentile(inside, percent) for percent in (1, 99))
    return max(GLARE_LIFT, round(GLARE_PART * (bright - dark)))


def _around(size_px: float, block_px: int) -> U8:
    """A kernel of the smallest odd number of blocks that is at least this many pixels wide."""
    blocks = math.ceil(size_px / block_px)
    return np.ones((blocks + 1 - blocks % 2,) * 2, dtype=np.uint8)


def _least(image: U8, block_px: int) -> U8:
    """The darkest pixel of each block."""
    least = padded(image, block_px, 255)
    step = 1
    while step < block_px:
        least = np.asarray(cv2.min(least[::2], least[1::2]), np.uint8)
        least = np.asarray(cv2.min(least[:, :-step], least[:, step:]), np.uint8)  # over 2 step columns from each one
        step *= 2
    return np.ascontiguousarray(least[:, ::block_px])


def _most(image: U8, block_px: int) -> U8:
    """The brightest pixel of each block."""
    return np.asarray(cv2.bitwise_not(_least(cv2.bitwise_not(image), block_px)), np.uint8)
