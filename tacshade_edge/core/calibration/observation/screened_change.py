"""Measure how much skin changed around a contact, from the grey maps, to compare presses.

The white ratio follows the skin's local shape, not its depth: under a flat it has saturated at 0.5 mm. What does grow
with depth is how much skin changed: the brightening inside the contact, and even more the darkening of its rim, which
wide and narrow objects share. The screened Poisson equation sums both over a neighbourhood (P. Bhat, B. Curless, M.
Cohen, C. L. Zitnick, "Fourier analysis of the 2D screened Poisson equation for gradient domain problems", ECCV 2008).
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from tacshade_edge.core.image.grey_maps import GreyMaps
from tacshade_edge.types import F32

# ℓ of the screened Poisson equation, in skin radii.
REACH_RADII = 0.4
# χ = ψ^(1-w) ψ⁻^w, ψ from all change, ψ⁻ from the darkening.
DARKENING_WEIGHT = 0.5
# Added to ψ⁻, so that a contact without a visible rim has a depth (grey levels).
DARKENING_FLOOR = 0.3
# Part of the reach for the brightening, so that the bright spots between pins merge into one patch.
BRIGHTENING_REACH = 0.22
# Skin around a contact's dark rim brightens a little too: subtract this much (grey levels).
LEAST_BRIGHTENING = 6.0


def screened_poisson(change: F32, reach_cells: float) -> F32:
    """Solution ψ of ψ - ℓ² ∇²ψ = change, by a cosine transform (mirrored borders): a mean over a neighbourhood of ℓ
    cells.
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
    """ψ of a change inside a disc: pads the window with zeros and clips rounding errors below 0."""
    m = 2 * math.ceil(reach_cells)
    return np.maximum(screened_poisson(np.pad(change, m), reach_cells)[m:-m, m:-m], 0)


def screened_change(maps: GreyMaps, reach_cells: float) -> F32:
    """χ in grey levels, 0 outside the disc; values that are not finite count as 0."""
    g_d = _finite_change(maps)
    psi = _within_disc(np.abs(g_d), reach_cells)
    darkening = _within_disc(np.maximum(-g_d, 0), reach_cells) + np.float32(DARKENING_FLOOR)
    chi = psi ** np.float32(1 - DARKENING_WEIGHT) * darkening ** np.float32(DARKENING_WEIGHT)
    return np.where(maps.inside, chi, np.float32(0)).astype(np.float32)


def screened_brightening(maps: GreyMaps, reach_cells: float) -> F32:
    """Screened brightening inside the contacts, one patch for each; grey levels."""
    g_d = _finite_change(maps)
    bright = np.maximum(g_d - np.float32(LEAST_BRIGHTENING), 0)
    return _within_disc(bright, BRIGHTENING_REACH * reach_cells)


def _finite_change(maps: GreyMaps) -> F32:
    """g_d clipped to its range, 0 outside the disc and where it is not finite."""
    good = np.isfinite(maps.g_d) & maps.inside
    return np.where(good, np.clip(maps.g_d, -255, 255), np.float32(0)).astype(np.float32)
