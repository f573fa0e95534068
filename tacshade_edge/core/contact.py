"""Is anything touched at all? Decided on absolute grey change, before any normalisation."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.core.greyscale import odd
from tacshade_edge.types import F32, U8, Bool, freeze

# The change that counts as contact: this many times the references' noise, and never less than the profile's level.
GATE_NOISE = 6.0
# The least area of skin over the threshold.
GATE_MM2 = 3.0
# Cells whose window is cut by the rim below this part of its full size do not vote: a shift of the camera shows there.
GATE_WINDOW_PART = 0.75

# Every box of so many pitches holds a piece of a black pin, in contact too (measured: at most 0.9); under glare it
# does not, and its darkest pixel is brighter than the reference's there by GLARE_LIFT or more.
GLARE_PITCHES = 1.0
GLARE_LIFT = 22
# So are pixels brighter than GLARE_GAIN times the brightest marker around in the reference plus GLARE_OFFSET.
GLARE_GAIN, GLARE_OFFSET = 1.3, 25
GLARE_PX = 6
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


def gate(g_d: F32, voting: Bool, noise_grey: float, cell_mm2: float, levels: float) -> GateResult:
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
    levels : float
        The least change that counts (`Profile.gate_levels`).
    """
    drift = light_drift(g_d, voting)
    threshold = max(levels, GATE_NOISE * noise_grey)
    over = int(np.count_nonzero((g_d - np.float32(drift) > threshold) & voting))
    return GateResult(contact=bool(over * cell_mm2 >= GATE_MM2), drift_grey=drift)


@dataclass(frozen=True, slots=True, eq=False)
class GlareCheck:
    """What a sensor looks like without glare.

    Attributes
    ----------
    darkest : uint8 (H, W)
        The brightest that the darkest pixel around may be.
    brightest : uint8 (H, W)
        The brightest that a pixel may be.
    box, halo : uint8 (n, n)
        Neighbourhoods as morphological kernels.
    """

    darkest: U8
    brightest: U8
    box: U8
    halo: U8

    def __post_init__(self) -> None:
        freeze(self, "darkest", "brightest", "box", "halo")


def glare_check(reference_grey: U8, mask: U8, pitch_px: float) -> GlareCheck:
    """Prepare the search for glare from the mean reference image."""
    size = odd(GLARE_PITCHES * pitch_px)
    halo = odd(2 * GLARE_HALO_PITCHES * pitch_px)
    box = np.ones((size, size), dtype=np.uint8)
    inside = cv2.multiply(reference_grey, mask)
    return GlareCheck(
        darkest=cv2.add(cv2.erode(reference_grey, box), GLARE_LIFT),
        brightest=cv2.convertScaleAbs(cv2.dilate(inside, box), alpha=GLARE_GAIN, beta=GLARE_OFFSET),
        box=box,
        halo=np.ones((halo, halo), dtype=np.uint8),
    )


def glare_mask(grey: U8, mask: U8, check: GlareCheck) -> U8 | None:
    """Pixels in and around specular spots that the reference does not have.

    Returns
    -------
    uint8 (H, W) or None
        1 where glare and its halo are; None without glare.
    """
    lifted = cv2.compare(cv2.erode(grey, check.box), check.darkest, cv2.CMP_GT)
    found = cv2.bitwise_and(lifted, mask)
    bright = cv2.bitwise_and(cv2.compare(grey, check.brightest, cv2.CMP_GT), mask)
    if cv2.countNonZero(bright) >= GLARE_PX:
        found = cv2.bitwise_or(found, bright)
    if cv2.countNonZero(found) == 0:
        return None
    grown: U8 = cv2.dilate(found, check.halo)
    return grown
