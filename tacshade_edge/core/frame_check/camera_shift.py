"""Measure the camera's shift since the reference, to explain an image that does not show the skin in its place."""

from __future__ import annotations

import math

import cv2
import numpy as np

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import F32

# Between these limits the frame is a shifted reference. One pixel along both axes (1.4) passes: it changes depths by a
# few per cent. Beyond half a pitch the pattern looks like itself again.
LEAST_PX, MOST_PITCHES = 1.8, 0.6
# Least response of the correlation: a shifted camera without contact gives 0.6 or more, a contact that shifts most of
# the pattern at most 0.43 (800 presses of 13 objects on 8 sensors).
LEAST_RESPONSE = 0.5


class CameraShift:
    """Measures the shift between images and the reference by phase correlation (Kuglin and Hines 1975).

    Parameters
    ----------
    reference : float32 (cells, cells), 0 to 1
        Share of white of the unloaded skin.
    cell_px, pitch_px : float
        Cell width and marker pitch in the camera's pixels.
    """

    def __init__(self, reference: F32, cell_px: float, pitch_px: float) -> None:
        self._reference = np.ascontiguousarray(reference, np.float32)
        self._window = cv2.createHanningWindow(reference.shape, cv2.CV_32F)
        self._cell_px = cell_px
        self._most_px = MOST_PITCHES * pitch_px

    def reason(self, cells: F32) -> Reason | None:
        """Why an image cannot be compared with the reference; None if the camera has not moved.

        Parameters
        ----------
        cells : float32 (cells, cells), 0 to 1
            Share of white of the image.
        """
        (cols, rows), response = cv2.phaseCorrelate(self._reference, cells, self._window)
        shift_px = math.hypot(rows, cols) * self._cell_px
        if response < LEAST_RESPONSE or not LEAST_PX <= shift_px <= self._most_px:
            return None
        return Reason(
            ReasonCode.CAMERA_SHIFT, f"the camera has moved by {shift_px:.1f} px since the reference was taken"
        )
