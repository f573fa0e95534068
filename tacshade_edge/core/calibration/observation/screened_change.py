"""How much the skin changed around a contact, from the grey maps: what presses are compared by.

The white ratio follows the skin's local shape, not its depth: under a flat it has risen all it can at 0.5 mm. What
does grow with depth is how much skin changed around: the brightening inside the contact, and even more the darkening
of its rim, which wide and narrow objects share. Both are summed over a neighbourhood by the screened Poisson equation
(P. Bhat, B. Curless, M. Cohen, C. L. Zitnick, "Fourier analysis of the 2D screened Poisson equation for gradient domain
problems", ECCV 2008).
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from tacshade_edge.core.image.grey_maps import GreyMaps
from tacshade_edge.types import F32

# ℓ of the screened Poisson equation, in skin radii.
REACH_RADII = 0.4
# χ = ψ^(1-w) ψ⁻^w with ψ of all change and ψ⁻ of the darkening.
DARKENING_WEIGHT = 0.5
# Added to ψ⁻, so that a contact without a rim in sight has a depth (grey levels).
DARKENING_FLOOR = 0.3
# The brightening is screened at this part of the reach, so that the bright spots between pins make one patch.
BRIGHTENING_REACH = 0.22
# Skin around a contact's dark rim brightens a little too; so little does not count (grey levels).
LEAST_BRIGHTENING = 6.0


def screened_poisson(change: F32, reach_cells: float) -> F32:
    """Solution ψ of ψ - ℓ² ∇²ψ = change: a mean over a neighbourhood of length ℓ.

    By a cosine transform (mirrored borders). A constant stays what it is.

    Parameters
    ----------
    change : float32 (rows, cols)
    reach_cells : float
        ℓ in cells.
    """
    rows, cols = change.shape
    even = cv2.copyMakeBorder(change, 0, rows % 2, 0, cols % 2, cv2.BORDER_REPLICATE)  # cv2.dct takes even sizes
    spectrum = cv2.dct(even)
    n, m = even.shape
    ky = 2 - 2 * np.cos(np.pi * np.arange(n, dtype=np.float32) / n)
    kx = 2 - 2 * np.cos(np.pi * np.arange(m, dtype=np.float32) / m)
    spectrum /= 1 + np.float32(reach_cells**2) * (ky[:, None] + kx[None, :])
    psi: F32 = cv2.idct(spectrum)[:rows, :cols]
    return psi


def _within_disc(change: F32, reach_cells: float) -> F32:
    """ψ of what lies in a disc: beyond its window nothing changes, and rounding leaves nothing below 0."""
    m = 2 * math.ceil(reach_cells)
    return np.maximum(screened_poisson(np.pad(change, m), reach_cells)[m:-m, m:-m], 0)


def screened_change(maps: GreyMaps, reach_cells: float) -> F32:
    """χ, in grey levels, 0 outside the disc; what is not finite counts as 0."""
    g_d = _finite_change(maps)
    psi = _within_disc(np.abs(g_d), reach_cells)
    darkening = _within_disc(np.maximum(-g_d, 0), reach_cells) + np.float32(DARKENING_FLOOR)
    chi = psi ** np.float32(1 - DARKENING_WEIGHT) * darkening ** np.float32(DARKENING_WEIGHT)
    return np.where(maps.inside, chi, np.float32(0)).astype(np.float32)


def screened_brightening(maps: GreyMaps, reach_cells: float) -> F32:
    """What brightened inside the contacts, one patch of each; grey levels."""
    g_d = _finite_change(maps)
    bright = np.maximum(g_d - np.float32(LEAST_BRIGHTENING), 0)
    return _within_disc(bright, BRIGHTENING_REACH * reach_cells)


def _finite_change(maps: GreyMaps) -> F32:
    """g_d within its range, 0 outside the disc and where it is not finite."""
    good = np.isfinite(maps.g_d) & maps.inside
    return np.where(good, np.clip(maps.g_d, -255, 255), np.float32(0)).astype(np.float32)
