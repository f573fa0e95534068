"""Check that a frame shows the sensor's skin, however deformed: cells that the network cannot explain are untrusted."""

from __future__ import annotations

import numpy as np

from tacshade_edge.core.frame_check.camera_shift import CameraShift
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.image.integral_image import CellMeans, IntegralImage
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import F32, Bool

UNTRUSTED_INVALID = 0.15
"""Part of the disc in untrusted rows above which a frame is torn or another image; below, it is degraded."""

UNTRUSTED_UNLEARNT = 0.10
"""Part of the disc in untrusted cells above which a press is not learnt from."""

UNTRUSTED_ROW = 0.6
"""Part of a row's cells above which the row is untrusted. Two images meet in a row, but a skin that the network does
not know, deep, tilted or dragged, is untrusted in patches."""

UNTRUSTED_SURE = 3.0
"""Log odds above which a cell is certainly untrusted: those of an unknown skin are lower, those of another image
higher."""

LEAST_ROW_CELLS = 8
"""Least number of a row's cells in the disc, of 112, for the row to count."""


class UntrustedCheck:
    """Rejects frames of one sensor that show something other than its skin.

    Parameters
    ----------
    preprocessor : Preprocessor
        Preprocessor of the images to check.
    """

    def __init__(self, preprocessor: Preprocessor) -> None:
        grid = disc_map.map_grid(preprocessor.calibration.geometry.disc)
        self._cells = CellMeans(preprocessor.integrator, grid)
        reference: F32 = self._cells.means(preprocessor.reference_white) / np.float32(255)
        camera_px = preprocessor.camera_px
        self._shift = CameraShift(reference, camera_px * grid.step_px, camera_px * preprocessor.calibration.pitch_px)

    def invalid_reason(self, untrusted_logit: F32 | None, inside: Bool, white: IntegralImage) -> Reason | None:
        """Why a frame cannot be used; None if it can.

        A frame is invalid if too many rows may be untrusted and it is a shifted reference, or if that many rows are
        certainly untrusted.

        Parameters
        ----------
        untrusted_logit : float32 (M, M) or None
            `Depth.untrusted_logit`; None if the solver reports none.
        inside : bool (rows, cols)
            The disc.
        white : IntegralImage
            `Preprocessed.white`.
        """
        if untrusted_logit is None:
            return self.moved(white)
        if untrusted_rows_part(untrusted_logit, inside) <= UNTRUSTED_INVALID:
            return None
        if reason := self.moved(white):
            return reason
        sure_part = untrusted_rows_part(untrusted_logit, inside, UNTRUSTED_SURE)
        if sure_part <= UNTRUSTED_INVALID:
            return None
        text = f"torn, or not an image from this sensor: {100 * sure_part:.0f} % of the disc does not show its skin"
        return Reason(ReasonCode.TORN, text)

    def moved(self, white: IntegralImage) -> Reason | None:
        """Reason that an image is a shifted reference; None if it is not."""
        return self._shift.reason(self._cells.means(white))


def degraded_reason(untrusted: Bool | None, inside: Bool) -> Reason | None:
    """Why untrusted cells degrade a frame; None if it has none, or the solver reports none."""
    if untrusted is None or not (part := untrusted_part(untrusted, inside)):
        return None
    return Reason(ReasonCode.UNTRUSTED, f"{100 * part:.1f} % of the disc does not show the sensor's skin")


def untrusted_part(untrusted: Bool, inside: Bool) -> float:
    """Part of the disc that is untrusted, 0 for a disc without cells; both arrays are bool (rows, cols)."""
    return float(np.count_nonzero(untrusted & inside) / max(int(np.count_nonzero(inside)), 1))


def untrusted_rows_part(untrusted_logit: F32, inside: Bool, least: float = 0.0) -> float:
    """Part of the disc in rows that are untrusted across it, counting cells above the `least` log odds.

    0 for a disc without cells; `untrusted_logit` is float32 (M, M), `inside` bool (rows, cols).
    """
    coarse: Bool = untrusted_logit > least
    if not coarse.any():
        return 0.0
    each = len(inside) // len(coarse)
    untrusted = coarse.repeat(each, axis=0).repeat(each, axis=1)
    cells = np.count_nonzero(inside, axis=1)
    fewest = max(LEAST_ROW_CELLS * len(inside) // disc_map.CELLS, 1)
    rows = (np.count_nonzero(untrusted & inside, axis=1) > UNTRUSTED_ROW * cells) & (cells >= fewest)
    return float(cells[rows].sum() / max(int(cells.sum()), 1))
