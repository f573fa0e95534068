"""How far the picture moved, by the pattern in it: for sensors around which nothing can be seen."""

from __future__ import annotations

import math

import cv2
import numpy as np

from tacshade_edge.types import F32

# Further than half a pitch the pattern looks like itself again.
MOST_PITCHES = 0.6
# How sharply frame and reference must agree on it: a shifted camera without contact gives 0.6 and more, a contact under
# which most of the pattern shifts 0.43 at most (800 presses of 13 objects on 8 sensors).
LEAST_RESPONSE = 0.5


class PatternShift:
    """Measures the shift between images and the reference by phase correlation (Kuglin and Hines 1975).

    Parameters
    ----------
    reference : float32 (cells, cells), 0 to 1
        White of the unloaded skin.
    cell_px, pitch_px : float
        In the camera's pixels.
    """

    def __init__(self, reference: F32, cell_px: float, pitch_px: float) -> None:
        self._reference = np.ascontiguousarray(reference, np.float32)
        self._window = cv2.createHanningWindow(reference.shape, cv2.CV_32F)
        self._cell_px = cell_px
        self._most_px = MOST_PITCHES * pitch_px

    def measure_px(self, cells: F32) -> float:
        """How far an image is the reference elsewhere; 0 where it is not.

        Parameters
        ----------
        cells : float32 (cells, cells), 0 to 1
            White of the image.
        """
        (cols, rows), response = cv2.phaseCorrelate(self._reference, cells, self._window)
        shift_px = math.hypot(rows, cols) * self._cell_px
        return shift_px if response >= LEAST_RESPONSE and shift_px <= self._most_px else 0.0
