"""Find where two frames meet in one image: a row of the disc that does not continue the rows above."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from tacshade_edge.core.image.median import median
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import F32, U8, Bool, freeze, frozen

# Two frames meet at a row that differs from the next by this much more than its neighbours do, in medians of all rows,
# and more than in the reference (good frames reach 1.9).
SPIKE = 2.1
ROW_PX = 60
BANDS, BAND_SPIKE = 4, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """The disc's n rows of at least ROW_PX pixels that have a next row.

    Attributes
    ----------
    first, last : int
        First row, and the row after the last.
    edges : ints (BANDS + 1,)
        Edges of the bands of columns.
    mask : uint8 (n, w)
        255 inside the disc, from the first edge to the last.
    width_px : float32 (BANDS + 1, n)
        Pixels of each row in each band and in all bands, at least 1.
    step : uint8 (n, w)
        Work space of `_spikes`.
    """

    first: int
    last: int
    edges: tuple[int, ...]
    mask: U8
    width_px: F32
    step: U8

    def __post_init__(self) -> None:
        freeze(self, "mask", "width_px")


@frozen
class TearCheck:
    """The disc's long rows, and the `_spikes` of the reference."""

    rows: _Rows
    usual: F32


def tear_check(reference_grey: U8, mask: Bool) -> TearCheck | None:
    """Prepare the check from the mean reference image and the disc's mask; None for fewer than 8 long rows."""
    long = np.flatnonzero(mask[:-1].sum(axis=1) >= ROW_PX)
    if long.size < 8:
        return None
    first, last = int(long[0]), int(long[-1]) + 1  # a disc's long rows are contiguous
    columns = np.flatnonzero(mask.any(axis=0))
    edges = tuple(np.linspace(columns[0], columns[-1] + 1, BANDS + 1).astype(int).tolist())
    widths = [mask[first:last, left:right].sum(axis=1) for left, right in pairwise(edges)]
    opaque = np.where(mask[first:last, edges[0] : edges[-1]], np.uint8(255), np.uint8(0))
    width_px = np.maximum(np.stack([*widths, sum(widths)]), 1).astype(np.float32)
    rows = _Rows(first, last, edges, opaque, width_px, np.empty_like(opaque))
    return TearCheck(rows, _spikes(reference_grey, rows, 0.0))


def torn_reason(grey: U8, check: TearCheck | None, camera_px: int) -> Reason | None:
    """Reason that a frame is torn, None if it is not; `camera_px` is a pixel's height in the camera's rows."""
    row = torn_row(grey, check) if check else None
    if row is None:
        return None
    return Reason(ReasonCode.TORN, f"torn: row {row * camera_px} does not match the rows above it")


def torn_row(grey: U8, check: TearCheck) -> int | None:
    """The row that the next does not continue, or None; the first and last two long rows cannot be judged."""
    over = _spikes(grey, check.rows, SPIKE) - check.usual
    at = int(np.argmax(over))
    return check.rows.first + 2 + at if over[at] > SPIKE else None


def _spikes(grey: U8, rows: _Rows, least: float) -> F32:
    """Difference of every row of the disc from the next, less that of its neighbours, over the median of all rows.

    Returns
    -------
    float32 (n - 4,)
        Without the first and last two rows, which lack neighbours. 0 where not above `least`, and where fewer than
        three of four bands of columns agree: a contact's edge may follow a row, but not across the disc.
    """
    first, last, left = rows.first, rows.last, rows.edges[0]
    disc = grey[first : last + 1, left : rows.edges[-1]]
    step = cv2.absdiff(disc[:-1], disc[1:], dst=rows.step)
    cv2.bitwise_and(step, rows.mask, dst=step)
    spikes = _over_neighbours(step, rows.width_px[-1])
    if spikes.max() <= least:
        return np.zeros_like(spikes)
    bands = [
        _over_neighbours(step[:, a - left : b - left], rows.width_px[band])
        for band, (a, b) in enumerate(pairwise(rows.edges))
    ]
    agree = np.count_nonzero(np.stack(bands) > BAND_SPIKE, axis=0) >= BANDS - 1
    return np.where(agree & (spikes > least), spikes, np.float32(0))


def _over_neighbours(step: U8, width_px: F32) -> F32:
    """Mean step of each row less that of the two rows before and after, in medians of all rows."""
    mean = cv2.reduce(step, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32F)[:, 0] / width_px
    around = (mean[:-4] + mean[1:-3] + mean[3:-1] + mean[4:]) / 4
    return np.asarray((mean[2:-2] - around) / (median(mean) + 1), np.float32)
