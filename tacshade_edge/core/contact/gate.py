"""Decide whether anything touches the skin, from the absolute grey change before any normalisation."""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.core.image.preprocess import Preprocessed, Preprocessor
from tacshade_edge.types import F32

# A change counts as contact if it exceeds this many times the references' noise and the profile's level.
GATE_NOISE = 6.0
# Least area of skin beyond the threshold.
GATE_MM2 = 3.0


class ContactGate:
    """The gate of one sensor and profile.

    Parameters
    ----------
    preprocessor : Preprocessor
        Provides the noise and the levels of the gate.
    """

    def __init__(self, preprocessor: Preprocessor) -> None:
        self._noise_grey = preprocessor.calibration.noise_grey
        self._cell_mm2 = preprocessor.cell_mm2
        self._levels = preprocessor.profile.gate_levels
        self._dark_levels = preprocessor.profile.gate_dark_levels

    def opens(self, preprocessed: Preprocessed) -> bool:
        """Whether anything touches the skin in an image."""
        return gate(
            preprocessed.g_d,
            preprocessed.drift_grey,
            self._noise_grey,
            self._cell_mm2,
            self._levels,
            self._dark_levels,
        )


def gate(
    g_d: F32, drift_grey: float, noise_grey: float, cell_mm2: float, levels: float, dark_levels: float = math.inf
) -> bool:
    """Whether enough skin changed to be in contact.

    Parameters
    ----------
    g_d : float32 (N,)
        Eq. 9 at the voting cells, positive in contact, not denoised.
    drift_grey : float
        Change of g that they share.
    noise_grey : float
        RMS of g without contact.
    cell_mm2 : float
        Area of skin per cell, mm².
    levels : float
        Least change that counts (`Profile.gate_levels`).
    dark_levels : float
        Least change away from contact that counts (`Profile.gate_dark_levels`): the rim of a contact.
    """
    noise = GATE_NOISE * noise_grey
    over = np.count_nonzero(g_d > np.float32(drift_grey + max(levels, noise)))
    under = np.count_nonzero(g_d < np.float32(drift_grey - max(dark_levels, noise)))
    return bool(max(over, under) * cell_mm2 >= GATE_MM2)
