"""Has the camera moved since the reference? Checked in contact, because a shifted pattern looks like one.

Skin that is dragged carries its pattern along, as a moved camera would, but the housing stays: where something of it
can be seen around the visible circle, it alone tells. Only where all is dark there the pattern has to.
"""

from __future__ import annotations

import numpy as np

from tacshade_edge.core.frame_check.housing_shift import CELL_PX, HousingShift
from tacshade_edge.core.frame_check.pattern_shift import PatternShift
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.image.integral_image import CellMeans, IntegralImage
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import F32, U8

# One pixel along both axes (1.4) is let pass: it changes depths by a few per cent.
LEAST_PX = 1.8
# How often a contact that lasts is checked.
PERIOD_NS = 100_000_000


class CameraShiftCheck:
    """The check of a stream of frames, every `PERIOD_NS`; of each frame once it has found a shift.

    Parameters
    ----------
    preprocessor : Preprocessor
        Whose images are checked.
    """

    def __init__(self, preprocessor: Preprocessor) -> None:
        calibration, self._camera_px = preprocessor.calibration, preprocessor.camera_px
        disc = calibration.geometry.disc
        self._housing = HousingShift(calibration.reference_grey, disc, CELL_PX // self._camera_px)
        grid = disc_map.map_grid(disc)
        self._cells = CellMeans(preprocessor.integrator, grid)
        reference: F32 = self._cells.means(preprocessor.reference_white) / np.float32(255)
        self._pattern = PatternShift(reference, grid.step_px, calibration.pitch_px)
        self._checked_ns = -PERIOD_NS

    def due(self, t_ns: int) -> bool:
        """Whether a frame of this time is to be checked; one of an earlier time belongs to a new stream."""
        return not 0 < t_ns - self._checked_ns < PERIOD_NS

    def check(self, grey: U8, white: IntegralImage, t_ns: int) -> Reason | None:
        """Why a frame cannot be compared with the reference; None when the camera is where it was.

        Parameters
        ----------
        grey : uint8 (H, W)
            Of `Preprocessor.grey`.
        white : IntegralImage
            Of the same frame.
        t_ns : int
        """
        housing = self._housing
        moved_px = housing.measure_px(grey) if housing.tells else self._pattern.measure_px(self._cells.means(white))
        shift_px = self._camera_px * moved_px
        self._checked_ns = -PERIOD_NS if shift_px >= LEAST_PX else t_ns
        if shift_px < LEAST_PX:
            return None
        return Reason(ReasonCode.CAMERA_SHIFT, f"camera moved by {shift_px:.1f} px since the reference")
