"""Does anything touch the skin? Decided on absolute grey change, before any normalisation."""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.core.image.preprocess import Preprocessed, Preprocessor
from tacshade_edge.types import F32

# The change that counts as contact: this many times the references' noise, and never less than the profile's level.
GATE_NOISE = 6.0
# The least area of skin over the threshold.
GATE_MM2 = 3.0


class ContactGate:
    """The gate of one sensor and profile.

    Parameters
    ----------
    preprocessor : Preprocessor
        Whose values are judged.
    """

    def __init__(self, preprocessor: Preprocessor) -> None:
        self._noise_grey = preprocessor.calibration.noise_grey
        self._cell_mm2 = preprocessor.cell_mm2
        self._levels = preprocessor.profile.gate_levels
        self._dark_levels = preprocessor.profile.gate_dark_levels

    def opens(self, preprocessed: Preprocessed) -> bool:
        """Whether anything touches in an image."""
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
    """Absolute contact gate.

    Parameters
    ----------
    g_d : float32 (N,)
        Eq. 9 at the cells that have a vote, positive in contact, not denoised.
    drift_grey : float
        The change of g that they have in common.
    noise_grey : float
        RMS of g without contact.
    cell_mm2 : float
        Area of skin per cell.
    levels : float
        The least change that counts (`Profile.gate_levels`).
    dark_levels : float
        The least change away from contact that counts (`Profile.gate_dark_levels`): the rim of a contact.
    """
    noise = GATE_NOISE * noise_grey
    over = np.count_nonzero(g_d > np.float32(drift_grey + max(levels, noise)))
    under = np.count_nonzero(g_d < np.float32(drift_grey - max(dark_levels, noise)))
    return bool(max(over, under) * cell_mm2 >= GATE_MM2)
