"""Whether a frame can be used at all, before any solver sees it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from tacshade_edge.types import F32, U8, Bool, Disc, freeze

BLOCK_PX = 8
# A camera that works never shows a disc this dark or this flat (grey levels).
BLACK_LEVEL = 12.0
FLAT_STD = 4.0
SATURATED_LEVEL = 250
SATURATED_PART = 0.25
# A block of the reference with at least this contrast has markers; it cannot lose them all.
TEXTURED_STD = 8.0
LOST_STD = 3.0
LOST_PART = 0.8
LOST_ROWS = 2
ROW_BLOCKS = 8
# Blocks of the surround never change but with the light; half of this many levels is noise.
SURROUND_LEVELS = 25.0
SURROUND_PART = 0.15
# The light may change by so much before the binarised image cannot be compared with the reference's.
LIGHT_LOW, LIGHT_HIGH = 0.45, 1.7
# Median difference of neighbouring pixels; the pattern itself has flat places enough to leave it near the noise, or
# so fine a pattern that the reference itself comes near it.
NOISE_STEP = 9.0
NOISE_OVER_REFERENCE = 5.0
# A row that differs from the next by this much more than its neighbours do, in medians of all rows, and more than the
# reference's does, is where two frames meet (good frames reach 1.4).
TEAR_SPIKE = 1.7
TEAR_ROW_PX = 60
TEAR_BANDS, TEAR_BAND_SPIKE = 4, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """The disc's rows: `edges` (TEAR_BANDS + 1) of the bands of columns, pixels (H, TEAR_BANDS + 1) of each row in each
    band and in all, at least 1, and which rows (H,) are `long`; fewer than 8 are none.
    """

    edges: tuple[int, ...]
    width_px: F32
    long: Bool


@dataclass(frozen=True, slots=True, eq=False)
class FrameCheck:
    """What a good frame of one sensor looks like, in blocks of 8x8 px.

    Attributes
    ----------
    mask : uint8 (H, W)
        1 inside the disc.
    inside, surround : bool (rows, cols)
        Blocks wholly inside, and wholly outside near, the disc.
    level, contrast : float32 (rows, cols)
        Mean and standard deviation of the reference's grey in each block.
    step : float
        Median difference of the reference's neighbouring pixels.
    bright : float
        Grey that a tenth of its disc exceeds.
    rows : _Rows
        Where the disc's rows are.
    spikes : float32 (H,)
        How much each row of the reference differs from the next, beside its neighbours.
    """

    mask: U8
    inside: Bool
    surround: Bool
    level: F32
    contrast: F32
    step: float
    bright: float
    rows: _Rows
    spikes: F32

    def __post_init__(self) -> None:
        freeze(self, "mask", "inside", "surround", "level", "contrast", "spikes")


def _blocks(grey: U8) -> tuple[F32, F32]:
    """Mean and standard deviation of whole 8x8 blocks."""
    rows, cols = grey.shape[0] // BLOCK_PX, grey.shape[1] // BLOCK_PX
    cut = np.ascontiguousarray(grey[: rows * BLOCK_PX, : cols * BLOCK_PX]).astype(np.float32)
    mean = cv2.resize(cut, (cols, rows), interpolation=cv2.INTER_AREA)
    square = cv2.resize(cut * cut, (cols, rows), interpolation=cv2.INTER_AREA)
    return mean, np.sqrt(np.maximum(square - mean * mean, 0))


def frame_check(reference_grey: U8, mask: Bool, disc: Disc) -> FrameCheck:
    """Prepare the check from the mean reference image."""
    height, width = reference_grey.shape
    rows, cols = max(height // BLOCK_PX, 1), max(width // BLOCK_PX, 1)
    inside = mask.astype(np.uint8)
    disc_rows = _rows(inside)
    if height < BLOCK_PX or width < BLOCK_PX:
        none = np.zeros((rows, cols), dtype=bool)
        flat = np.zeros((rows, cols), dtype=np.float32)
        spikes = np.zeros(height, dtype=np.float32)
        return FrameCheck(inside, none, none, flat, flat, 0.0, 0.0, disc_rows, spikes)
    middle = (BLOCK_PX - 1) / 2
    r = np.hypot(
        BLOCK_PX * np.arange(rows)[:, None] + middle - disc.row_c,
        BLOCK_PX * np.arange(cols)[None, :] + middle - disc.col_c,
    )
    half_diagonal = BLOCK_PX * 0.7072
    level, contrast = _blocks(reference_grey)
    surround = (r > disc.radius_px + half_diagonal + 2) & (r < 1.35 * disc.radius_px)
    return FrameCheck(
        mask=inside,
        inside=r < disc.radius_px - half_diagonal,
        surround=surround,
        level=level,
        contrast=contrast,
        step=_noise_step(reference_grey, mask),
        bright=_bright(reference_grey, mask),
        rows=disc_rows,
        spikes=_row_spikes(reference_grey, inside, disc_rows),
    )


def invalid_reason(grey: U8, check: FrameCheck) -> str:
    """Why a frame cannot be used, in a few words; empty for a good one.

    Parameters
    ----------
    grey : uint8 (H, W)
    check : FrameCheck
    """
    height, width = check.mask.shape
    if grey.shape != check.mask.shape:
        return f"size: {grey.shape[1]}x{grey.shape[0]} px, calibrated for {width}x{height}"
    inside_px = cv2.countNonZero(check.mask)
    if inside_px == 0:
        return "disc: no pixel of the visible circle lies in the image"
    mean, std = (float(v[0, 0]) for v in cv2.meanStdDev(grey, mask=check.mask))
    bright = cv2.countNonZero(cv2.compare(cv2.bitwise_and(grey, grey, mask=check.mask), SATURATED_LEVEL, cv2.CMP_GE))
    if bright > SATURATED_PART * inside_px:
        return f"saturated: {100 * bright / inside_px:.0f} % of the disc at {SATURATED_LEVEL} or above"
    if std < FLAT_STD:
        return f"{'black' if mean < BLACK_LEVEL else 'no contrast'}: mean grey {mean:.0f}, deviation {std:.1f}"
    step = _noise_step(grey, check.mask > 0)
    if step > max(NOISE_STEP, check.step + NOISE_OVER_REFERENCE):
        return f"noise: neighbouring pixels differ by {step:.0f} grey levels"
    return _compared_reason(grey, check)


def _noise_step(grey: U8, mask: Bool) -> float:
    """Median difference of horizontal neighbours on every eighth row of the disc."""
    rows, inside = grey[::8].astype(np.int16), mask[::8, 1:]
    return float(np.median(np.abs(np.diff(rows, axis=1))[inside])) if inside.any() else 0.0


def _bright(grey: U8, mask: Bool) -> float:
    """Grey level that a tenth of the disc exceeds; of every fourth pixel in both directions."""
    inside = grey[::4, ::4][mask[::4, ::4]]
    return float(np.percentile(inside, 90)) if inside.size else 0.0


def _rows(mask: U8) -> _Rows:
    long = mask.sum(axis=1, dtype=np.int64) >= TEAR_ROW_PX
    if np.count_nonzero(long) < 8:
        return _Rows((), np.ones((mask.shape[0], TEAR_BANDS + 1), dtype=np.float32), np.zeros_like(long))
    columns = np.flatnonzero(mask.any(axis=0))
    edges = tuple(np.linspace(columns[0], columns[-1] + 1, TEAR_BANDS + 1).astype(int).tolist())
    widths = [mask[:, left:right].sum(axis=1, dtype=np.float32) for left, right in pairwise(edges)]
    return _Rows(edges, np.maximum(np.stack([*widths, sum(widths)], axis=1), 1), long)


def _row_spikes(grey: U8, mask: U8, rows: _Rows) -> F32:
    """How much every row of the disc differs from the next beside its neighbours, over the median of all rows.

    Returns
    -------
    float32 (H,)
        0 for short rows, and where fewer than three of four bands of columns agree: a contact's edge may follow a
        row, but not across the disc.
    """
    spikes = np.zeros(grey.shape[0], dtype=np.float32)
    if not rows.edges:
        return spikes
    step = cv2.multiply(cv2.absdiff(grey[:-1], grey[1:]), mask[:-1])
    mean = np.zeros((grey.shape[0], TEAR_BANDS + 1), dtype=np.float32)
    for band, (left, right) in enumerate(pairwise(rows.edges)):
        mean[:-1, band] = cv2.reduce(step[:, left:right], 1, cv2.REDUCE_SUM, dtype=cv2.CV_32F)[:, 0]
    mean[:, -1] = mean[:, :-1].sum(axis=1)
    mean /= rows.width_px
    # The first and last long rows have no neighbours to be compared with.
    padded = np.concatenate((mean[-2:], mean, mean[:2]))
    around = (padded[:-4] + padded[1:-3] + padded[3:-1] + padded[4:]) / 4
    each = (mean - around) / (np.median(mean[rows.long], axis=0) + 1)
    agree = np.count_nonzero(each[:, :-1] > TEAR_BAND_SPIKE, axis=1) >= TEAR_BANDS - 1
    seen = rows.long & np.roll(rows.long, 2) & np.roll(rows.long, -2) & agree
    spikes[seen] = each[seen, -1]
    return spikes


def _compared_reason(grey: U8, check: FrameCheck) -> str:
    """What the reference tells: torn, moved, other light."""
    if not check.inside.any():
        return ""
    level, contrast = _blocks(grey)
    textured = check.inside & (check.contrast >= TEXTURED_STD)
    # A contact can hide the markers of a patch, never those of whole rows across the disc.
    total, lost = textured.sum(axis=1), (textured & (contrast < LOST_STD)).sum(axis=1)
    empty = int(np.count_nonzero((total >= ROW_BLOCKS) & (lost > LOST_PART * total)))
    if empty >= LOST_ROWS:
        return f"torn: {empty * BLOCK_PX} rows across the disc show no marker"
    over = _row_spikes(grey, check.mask, check.rows) - np.maximum(check.spikes, 0)
    if over.max(initial=0.0) > TEAR_SPIKE:
        return f"torn: row {int(np.argmax(over))} does not continue the rows above"
    if not textured.any():
        return ""
    # A deep contact darkens or brightens most of the disc, but some markers stay as bright as the light: those tell
    # less light. More light saturates them; there the common level tells.
    gain = _bright(grey, check.mask > 0) / max(check.bright, 1.0)
    common = float(np.median(level[textured])) / max(float(np.median(check.level[textured])), 1.0)
    if gain < LIGHT_LOW or common > LIGHT_HIGH:
        found = gain if gain < LIGHT_LOW else common
        return f"light: {found:.2f} times the reference's, expected {LIGHT_LOW} to {LIGHT_HIGH}"
    if not check.surround.any():
        return ""
    # The surround's own light: a contact changes the brightness of the whole disc.
    ratio = float(np.median(level[check.surround] / np.maximum(check.level[check.surround], 1)))
    expected = np.minimum(check.level * np.float32(min(max(ratio, LIGHT_LOW), LIGHT_HIGH)), 255)
    moved = check.surround & (np.abs(level - expected) > SURROUND_LEVELS + 0.25 * expected)
    part = np.count_nonzero(moved) / np.count_nonzero(check.surround)
    if part > SURROUND_PART:
        return f"torn or moved: {100 * part:.0f} % of the surround differs from the reference"
    return ""
