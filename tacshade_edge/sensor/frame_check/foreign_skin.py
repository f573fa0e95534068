"""Judge the skin: do all cells show this sensor's, however deformed?

A network's map says so. Without one, plain tests find rows without markers and, on a skin at rest,
a row of the disc that does not continue the rows above.
"""

from __future__ import annotations

import math
from itertools import pairwise

import cv2
import numpy as np

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.frame_check.picture import Measured
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.image.white import median, squares
from tacshade_edge.types import F32, U8, Bool, Disc

# Log odds above which a cell is certainly untrusted: those of an unknown skin are lower, those of
# another image higher. Part of a row's cells above which the row is untrusted: two images meet in a
# row, but a skin that the network does not know, deep, tilted or dragged, is untrusted in patches.
# Part of the disc in such rows above which a frame is torn or another image.
UNTRUSTED_SURE, UNTRUSTED_ROW, UNTRUSTED_INVALID = 3.0, 0.6, 0.15
# Part of the disc in untrusted cells above which a press is not learnt from.
UNTRUSTED_UNLEARNT = 0.10
# Least number of a row's cells in the disc, of 112, for the row to count.
LEAST_ROW_CELLS = 8
# Squares of a pitch with at least the first deviation have a marker, below the second none. A
# contact can hide the markers of a patch, never those of this part of two whole rows across the
# disc, unless they have few.
TEXTURED_STD, LOST_STD, LOST_PART, LOST_ROWS, ROW_SQUARES, LEAST_SQUARE_PX = 8.0, 3.0, 0.95, 2, 4, 8
# Two frames meet at a row that differs from the next by this much more than its neighbours do, in
# medians of all rows, and more than in the reference (good frames reach 1.9), in three of four
# bands of columns: a contact's edge may follow a row, but not across the disc.
SPIKE, ROW_PX, BANDS, BAND_SPIKE = 2.1, 60, 4, 0.5
# Fewer rows of `ROW_PX` have hardly a row with two neighbours on each side.
LEAST_ROWS = 8


def map_measured(untrusted_logit: F32 | None, inside: Bool) -> tuple[Measured, ...]:
    """What is measured of a network's map, float32 (M, M);
    `inside` is the disc, bool (rows, cols).
    """
    if untrusted_logit is None:
        return ()
    part = untrusted_rows_part(untrusted_logit, inside, UNTRUSTED_SURE)
    text = (
        "torn, or not an image from this sensor: "
        f"{100 * part:.0f} % of the disc does not show its skin"
    )
    reason = Reason(ReasonCode.TORN, text)
    return (
        Measured("skin", "part of the disc without this skin", part, 0, UNTRUSTED_INVALID, reason),
    )


def degraded_reason(untrusted: Bool | None, inside: Bool) -> Reason | None:
    """Why untrusted cells degrade a frame; None if it has none, or the solver reports none."""
    if untrusted is None or not (part := untrusted_part(untrusted, inside)):
        return None
    return Reason(
        ReasonCode.UNTRUSTED, f"{100 * part:.1f} % of the disc does not show the sensor's skin"
    )


def untrusted_part(untrusted: Bool, inside: Bool) -> float:
    """Part of the disc that is untrusted, 0 for a disc without cells;
    both arrays are bool (rows, cols).
    """
    return float(np.count_nonzero(untrusted & inside) / max(int(np.count_nonzero(inside)), 1))


def untrusted_rows_part(untrusted_logit: F32, inside: Bool, least: float = 0.0) -> float:
    """Part of the disc in rows that are untrusted across it, counting cells above the `least` log
    odds; 0 for an empty disc.
    """
    coarse: Bool = untrusted_logit > least
    if not coarse.any():
        return 0.0
    each = len(inside) // len(coarse)
    untrusted = coarse.repeat(each, axis=0).repeat(each, axis=1)
    cells = np.count_nonzero(inside, axis=1)
    fewest = max(LEAST_ROW_CELLS * len(inside) // disc_map.CELLS, 1)
    rows = (np.count_nonzero(untrusted & inside, axis=1) > UNTRUSTED_ROW * cells) & (
        cells >= fewest
    )
    return float(cells[rows].sum() / max(int(cells.sum()), 1))


class PlainSkinJudge:
    """Judges images without a network; parameters as of `Judges`.

    A pressed pattern along the camera's rows would look torn.
    """

    def __init__(
        self,
        reference_grey: U8,
        mask: Bool,
        disc: Disc,
        pitch_px: float,
        camera_px: int,
        *,
        unloaded: bool,
    ):
        self._camera_px = camera_px
        self._square_px = max(math.ceil(pitch_px), LEAST_SQUARE_PX)
        shape = (
            reference_grey.shape[0] // self._square_px,
            reference_grey.shape[1] // self._square_px,
        )
        rows, cols = (self._square_px * (np.arange(count) + 0.5) - 0.5 for count in shape)
        r = np.hypot(rows[:, None] - disc.row_c, cols[None, :] - disc.col_c)
        inside = r < disc.radius_px - self._square_px * 0.7072
        self._textured: Bool = inside & (
            squares(reference_grey, self._square_px)[1] >= TEXTURED_STD
        )
        total = np.count_nonzero(self._textured, axis=1)
        # If most of a row's squares are already flat, a contact may well hide the others.
        enough = total >= np.maximum(ROW_SQUARES, np.count_nonzero(inside, axis=1) / 2)
        self._lost_most = np.where(enough, LOST_PART * total, np.inf)
        long = np.flatnonzero(np.count_nonzero(mask[:-1], axis=1) >= ROW_PX)
        self._rows = None
        if unloaded and long.size >= LEAST_ROWS:
            self._rows = slice(int(long[0]), int(long[-1]) + 2)  # a disc's long rows are contiguous
            columns = np.flatnonzero(mask.any(axis=0))
            self._edges = np.linspace(columns[0], columns[-1] + 1, BANDS + 1).astype(int).tolist()
            self._mask: U8 = np.where(mask[self._rows], np.uint8(255), np.uint8(0))
            self._usual = self._spikes(reference_grey)

    def measured(self, grey: U8) -> tuple[Measured, ...]:
        """What is measured of an image, uint8 (H, W)."""
        lost = self._textured & (squares(grey, self._square_px)[1] < LOST_STD)
        empty = int(np.count_nonzero(np.count_nonzero(lost, axis=1) > self._lost_most))
        px = empty * self._square_px * self._camera_px
        text = f"torn: {px} rows across the disc show no markers"
        made = (
            Measured(
                "skin",
                "rows without markers",
                empty,
                0,
                LOST_ROWS - 1,
                Reason(ReasonCode.TORN, text),
            ),
        )
        if self._rows is None:
            return made
        over = self._spikes(grey) - self._usual
        at = int(over.argmax())
        text = (
            f"torn: row {(self._rows.start + 2 + at) * self._camera_px} does not match the rows "
            "above it"
        )
        return (
            *made,
            Measured(
                "skin",
                "step of a row",
                float(over[at]),
                -math.inf,
                SPIKE,
                Reason(ReasonCode.TORN, text),
            ),
        )

    def _spikes(self, grey: U8) -> F32:
        """How much each row of the disc differs from the next beside its neighbours:
        float32 (rows - 4,).
        """
        rows = grey[self._rows]
        step = cv2.bitwise_and(cv2.absdiff(rows[:-1], rows[1:]), self._mask[:-1])
        bands = [(self._edges[0], self._edges[-1]), *pairwise(self._edges)]
        whole, *each = (_over_neighbours(step[:, a:b], self._mask[:-1, a:b]) for a, b in bands)
        agree = np.count_nonzero(np.stack(each) > BAND_SPIKE, axis=0) >= BANDS - 1
        return np.where(agree, np.maximum(whole, 0), np.float32(0))


def _over_neighbours(step: U8, mask: U8) -> F32:
    """Mean step of each row less that of the two rows before and after, in medians of all rows."""
    total, width = (
        cv2.reduce(each, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32F)[:, 0] for each in (step, mask)
    )
    mean = total / np.maximum(width / 255, 1)
    around = (mean[:-4] + mean[1:-3] + mean[3:-1] + mean[4:]) / 4
    return np.asarray((mean[2:-2] - around) / (median(mean) + 1), np.float32)
