"""Compare blocks of 8x8 px with the reference's: lost markers, other light, another surround."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from tacshade_edge.core.image.binarise import halved
from tacshade_edge.core.image.median import median
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import F32, F64, U8, Bool, Disc, frozen

# Three halvings make a block's mean; the first check of a frame lets two of them round.
BLOCK_PX, HALVINGS, ROUNDED = 8, 3, 2
# A block of the reference with at least this contrast has markers; whole rows of the disc cannot lose them all.
TEXTURED_STD = 8.0
LOST_STD = 3.0
LOST_PART = 0.95
LOST_ROWS = 2
ROW_BLOCKS = 8
# Blocks of the surround change only with the light; half of this many levels is noise. It begins at this many radii
# from the disc's middle, because a soft tip that sways carries its markers past the edge.
SURROUND_FROM = 1.1
SURROUND_LEVELS = 25.0
SURROUND_PART = 0.15
# Blocks of the surround below this grey do not show the amount of light; a thresholded image has many.
LIT_LEVEL = 4.0
# Beyond this change of light, the binarised image cannot be compared with the reference's.
LIGHT_LOW, LIGHT_HIGH = 0.45, 1.7

Box = tuple[slice, slice]
Places = npt.NDArray[np.intp]


@frozen
class BlockCheck:
    """The reference in (rows, cols) blocks of 8x8 px, which cover the pixels `box`.

    Attributes
    ----------
    textured : bool (rows, cols)
        Blocks wholly inside the disc, with markers.
    lost_most : float64 (rows,)
        Number of textured blocks of each row that may lose their markers; infinite for rows with few.
    lost_fewest : float
        With at most this many lost blocks in all, fewer than `LOST_ROWS` rows can exceed theirs.
    textured_at, surround_at : intp (n,)
        Flat indices of the textured blocks, and of blocks wholly outside but near the disc.
    common : float
        Median of the textured blocks' means, at least 1.
    surround : float32 (n,)
        Means of the blocks of the surround.
    lit_at : intp (m,)
        Indices of those that show the light.
    per_lit : float32 (m,)
        Reciprocals of their means.
    camera_px : int
        Width of a pixel here in the camera's pixels, in which reasons are given.
    """

    box: Box
    textured: Bool
    lost_most: F64
    lost_fewest: float
    textured_at: Places
    surround_at: Places
    common: float
    surround: F32
    lit_at: Places
    per_lit: F32
    camera_px: int


def block_check(reference_grey: U8, disc: Disc, camera_px: int = 1) -> BlockCheck | None:
    """Prepare the check from the mean reference image; None if no block lies inside the disc."""
    middle = (BLOCK_PX - 1) / 2
    r = np.hypot(
        np.arange(reference_grey.shape[0] // BLOCK_PX)[:, None] * BLOCK_PX + middle - disc.row_c,
        np.arange(reference_grey.shape[1] // BLOCK_PX)[None, :] * BLOCK_PX + middle - disc.col_c,
    )
    half_diagonal = BLOCK_PX * 0.7072
    inside = r < disc.radius_px - half_diagonal
    if not inside.any():
        return None
    surround = (r > SURROUND_FROM * disc.radius_px + half_diagonal) & (r < 1.35 * disc.radius_px)
    rows, cols = (slice(int(at.min()), int(at.max()) + 1) for at in np.nonzero(inside | surround))
    inside, surround = inside[rows, cols], surround[rows, cols]
    box = (_pixels(rows), _pixels(cols))
    level, variance = block_means(reference_grey[box], 0)
    textured = inside & (variance >= TEXTURED_STD**2)
    total = textured.sum(axis=1)
    surround_at = np.flatnonzero(surround)
    usual: F32 = level.take(surround_at)
    lit_at = np.flatnonzero(usual >= LIT_LEVEL)
    # If most of a row's blocks are already flat, a contact may well hide the others.
    lost_most = np.where(total >= np.maximum(ROW_BLOCKS, inside.sum(axis=1) / 2), LOST_PART * total, np.inf)
    return BlockCheck(
        box=box,
        textured=textured,
        lost_most=lost_most,
        lost_fewest=float(np.sort(lost_most)[:LOST_ROWS].sum()) if len(lost_most) >= LOST_ROWS else math.inf,
        textured_at=np.flatnonzero(textured),
        surround_at=surround_at,
        common=max(median(level[textured]), 1.0) if textured.any() else 1.0,
        surround=usual,
        lit_at=lit_at,
        per_lit=np.reciprocal(usual[lit_at]),
        camera_px=camera_px,
    )


def _pixels(blocks: slice) -> slice:
    return slice(BLOCK_PX * blocks.start, BLOCK_PX * blocks.stop)


def block_reasons(grey: U8, check: BlockCheck, rounded: int) -> tuple[Reason | None, Reason | None]:
    """Reasons for lost markers, and for other light or surround; `rounded` above 0 finds both in too many frames."""
    level, variance = block_means(grey[check.box], rounded)
    slack = rounded / 2
    lost = _lost_reason(variance, check, slack)
    return lost, _bright_reason(level, check, slack) or _surround_reason(level, check, slack)


def block_means(grey: U8, rounded: int) -> tuple[F32, F32]:
    """Mean and variance of 8x8 blocks from repeated means of 2x2 px, the first `rounded` ones in whole grey levels.

    Parameters
    ----------
    grey : uint8 (8 rows, 8 cols)
    rounded : int
        Number of halvings that round, 0 to 2; each errs by at most half a level.

    Returns
    -------
    mean : float32 (rows, cols)
        Within `rounded` / 2 levels.
    variance : float32 (rows, cols)
        Variance after the rounded halvings: its root is at most `rounded` / 2 levels above the pixels' deviation.
    """
    for _ in range(rounded):
        grey = halved(grey)
    mean = grey.astype(np.float32)
    square = mean * mean
    for _ in range(HALVINGS - rounded):
        mean, square = halved(mean), halved(square)
    return mean, square - mean * mean


def light_reason(found: float) -> Reason:
    """Reason for a light that is `found` times the reference's."""
    text = f"light: found {found:.2f} times the reference's brightness, expected {LIGHT_LOW} to {LIGHT_HIGH} times"
    return Reason(ReasonCode.LIGHT, text)


def _lost_reason(variance: F32, check: BlockCheck, slack: float) -> Reason | None:
    # A contact can hide the markers of a patch, never those of whole rows across the disc.
    flat = (variance < (LOST_STD + slack) ** 2) & check.textured
    if np.count_nonzero(flat) <= check.lost_fewest:
        return None
    empty = np.count_nonzero(np.count_nonzero(flat, axis=1) > check.lost_most)
    rows = empty * BLOCK_PX * check.camera_px
    if empty < LOST_ROWS:
        return None
    return Reason(ReasonCode.TORN, f"torn: {rows} rows across the disc show no markers")


def _bright_reason(level: F32, check: BlockCheck, slack: float) -> Reason | None:
    levels = level.take(check.textured_at)
    # If the median exceeds the limit, so does half of them.
    if 2 * np.count_nonzero(levels > np.float32(0.999 * (LIGHT_HIGH * check.common - slack))) < levels.size:
        return None
    common = (median(levels) + slack) / check.common
    return light_reason(common) if common > LIGHT_HIGH else None


def _surround_reason(level: F32, check: BlockCheck, slack: float) -> Reason | None:
    """Reason for blocks of the surround that differ, beyond `slack`, from the reference in today's light, if any."""
    usual = check.surround
    if not usual.size:
        return None
    found = level.take(check.surround_at)
    low, high = found - slack, found + slack
    # Use the surround's own light, because a contact changes the brightness of the whole disc.
    lit = check.lit_at
    gains = (median(end[lit] * check.per_lit) if lit.size else 1.0 for end in (low, high))
    least, most = (min(max(gain, LIGHT_LOW), LIGHT_HIGH) for gain in gains)
    brighter = np.count_nonzero(high - (1.25 * least) * usual > SURROUND_LEVELS)
    darker = np.count_nonzero(np.minimum((0.75 * most) * usual, 0.75 * 255) - low > SURROUND_LEVELS)
    part = (brighter + darker) / usual.size  # without slack, no block is both
    if part <= SURROUND_PART:
        return None
    text = f"torn or moved: {100 * part:.0f} % of the image around the disc differs from the reference"
    return Reason(ReasonCode.SURROUND, text)
