"""Does a frame show the sensor's skin, however it is deformed? What the network cannot explain as that is untrusted."""

from __future__ import annotations

import numpy as np

from tacshade_edge.core.frame_check.camera_shift import CameraShift
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.image.integral_image import CellMeans, IntegralImage
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import F32, Bool

UNTRUSTED_INVALID = 0.15
"""With more of the disc in untrusted rows than this the frame is torn or another picture; all else is a doubt."""

UNTRUSTED_UNLEARNT = 0.10
"""With more of its disc untrusted, in whatever cells, a press is not learnt from."""

UNTRUSTED_ROW = 0.6
"""A row with more untrusted cells than this part is untrusted. Two pictures meet in a row, but a skin that the network
does not know, deep, tilted or dragged, is untrusted in patches."""

UNTRUSTED_SURE = 3.0
"""Log odds from which on a cell counts for that: what a skin that the network does not know shows is doubtful, what
another picture shows is not."""

LEAST_ROW_CELLS = 8
"""A row of fewer cells in the disc, of 112, has no say."""


class UntrustedCheck:
    """Why the frames of one sensor are refused that show something else than its skin.

    Parameters
    ----------
    preprocessor : Preprocessor
        Whose images are checked.
    """

    def __init__(self, preprocessor: Preprocessor) -> None:
        grid = disc_map.map_grid(preprocessor.calibration.geometry.disc)
        self._cells = CellMeans(preprocessor.integrator, grid)
        reference: F32 = self._cells.means(preprocessor.reference_white) / np.float32(255)
        camera_px = preprocessor.camera_px
        self._shift = CameraShift(reference, camera_px * grid.step_px, camera_px * preprocessor.calibration.pitch_px)

    def invalid_reason(self, untrusted_logit: F32 | None, inside: Bool, white: IntegralImage) -> Reason | None:
        """Why a frame cannot be used; None for one that can.

        A frame is refused that may be untrusted in too many rows and is the reference, shifted; and one that surely is
        untrusted in so many.

        Parameters
        ----------
        untrusted_logit : float32 (M, M) or None
            `Depth.untrusted_logit`; None where the solver reports nothing.
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
        text = (
            f"torn, or not an image of the sensor: {100 * sure_part:.0f} % of the disc does not show the sensor's skin"
        )
        return Reason(ReasonCode.TORN, text)

    def moved(self, white: IntegralImage) -> Reason | None:
        """Whether a picture that is not as it was, though nothing is found to touch, is the reference, shifted."""
        return self._shift.reason(self._cells.means(white))


def degraded_reason(untrusted: Bool | None, inside: Bool) -> Reason | None:
    """Why a frame deserves less trust some of whose disc is untrusted; None where none is, or no solver reports it."""
    if untrusted is None or not (part := untrusted_part(untrusted, inside)):
        return None
    return Reason(ReasonCode.UNTRUSTED, f"{100 * part:.1f} % of the disc does not show the sensor's skin")


def untrusted_part(untrusted: Bool, inside: Bool) -> float:
    """Part of the disc that is untrusted, 0 of a disc without cells; bool (rows, cols) both."""
    return float(np.count_nonzero(untrusted & inside) / max(int(np.count_nonzero(inside)), 1))


def untrusted_rows_part(untrusted_logit: F32, inside: Bool, least: float = 0.0) -> float:
    """Part of the disc in rows that are untrusted across it, in cells of more than the `least` log odds.

    0 as above; float32 (M, M), bool (rows, cols).
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
