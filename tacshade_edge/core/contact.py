"""Is anything touched at all? Decided on absolute grey change, before any normalisation."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.core.greyscale import odd
from tacshade_edge.types import F32, U8, Bool

# The change that counts as contact: this many times the references' noise, and never less than GATE_LEVELS.
GATE_NOISE = 6.0
GATE_LEVELS = 14.0
# The least area of skin over the threshold.
GATE_MM2 = 1.5
# Cells whose window is cut by the rim below this part of its full size do not vote: a shift of the camera shows there.
GATE_WINDOW_PART = 0.75

GLARE_LEVEL = 250
# A patch at GLARE_LEVEL is glare when a box of this many pitches fits into it; no gap between pins is so large.
GLARE_PITCHES = 0.45
# The halo around a glare spot that is not trusted either, in pitches.
GLARE_HALO_PITCHES = 1.0


@dataclass(frozen=True, slots=True)
class GateResult:
    """Whether the skin is touched, and the common-mode change (light) that was taken off, grey levels."""

    contact: bool
    drift_grey: float


def light_drift(g_d: F32, voting: Bool) -> float:
    """Median of g_d over the disc: a change of light moves every cell, a contact only some."""
    return float(np.median(g_d[voting])) if voting.any() else 0.0


def gate(g_d: F32, voting: Bool, noise_grey: float, cell_mm2: float) -> GateResult:
    """Absolute contact gate.

    Parameters
    ----------
    g_d : float32 (rows, cols)
        Eq. 9, positive in contact, not denoised.
    voting : bool (rows, cols)
        Cells that may raise contact.
    noise_grey : float
        RMS of g without contact.
    cell_mm2 : float
        Area of skin per cell.
    """
    drift = light_drift(g_d, voting)
    threshold = max(GATE_LEVELS, GATE_NOISE * noise_grey)
    over = int(np.count_nonzero((g_d - np.float32(drift) > threshold) & voting))
    return GateResult(contact=bool(over * cell_mm2 >= GATE_MM2), drift_grey=drift)


def glare_mask(grey: U8, mask: U8, pitch_px: float) -> U8 | None:
    """Pixels around specular spots that are larger than any gap between pins.

    Returns
    -------
    uint8 (H, W) or None
        1 where glare and its halo are; None without glare.
    """
    bright = cv2.bitwise_and(cv2.threshold(grey, GLARE_LEVEL - 1, 1, cv2.THRESH_BINARY)[1], mask)
    if cv2.countNonZero(bright) == 0:
        return None
    size = odd(GLARE_PITCHES * pitch_px)
    core = cv2.erode(bright, np.ones((size, size), dtype=np.uint8), borderValue=0)
    if cv2.countNonZero(core) == 0:
        return None
    halo = odd(size + 2 * GLARE_HALO_PITCHES * pitch_px)
    grown: U8 = cv2.dilate(core, np.ones((halo, halo), dtype=np.uint8))
    return grown
