"""The cheapest thing that is right: calibrated depth from gathered grey change, or α · g_hn without a calibration.

The white ratio follows the skin's local shape, not its depth: under a flat it has risen all it can at 0.5 mm, so no
table of g_d itself tells 1 mm from 5. What does grow with depth is how much skin changed around: the brightening inside
the contact, and even more the darkening of its rim, which wide and narrow objects share. So the depth of a contact
comes from a table of the change χ gathered around it, and its shape from the brightening inside it.
"""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.core.greyscale import shape_grey
from tacshade_edge.core.solvers.base import Depth, DepthScale, GreyMaps
from tacshade_edge.types import F32

# The reach of the gathering, in skin radii: 8 mm on a skin of 20 mm.
REACH_RADII = 0.4
# χ = ψ^(1-w) ψ⁻^w with ψ gathered from all change and ψ⁻ from the darkening. Calibrated on balls, w = 0 finds flat
# objects a quarter too deep (docs/decisions/0003).
DARKENING_WEIGHT = 0.5
# Added to ψ⁻, so that a contact without a rim in sight has a depth (grey levels).
DARKENING_FLOOR = 0.3
# The brightening is gathered over this part of the reach, so that the bright spots between pins make one patch.
SHAPE_REACH = 0.22
# The brightest place within this part of the reach gets the depth of its neighbourhood.
NEIGHBOUR_REACH = 0.55
# Skin around a contact's dark rim brightens a little too; so little does not count (grey levels).
SHAPE_DEAD = 6.0
# A patch that brightens less than this, or than this part of the brightest, keeps only its share of the depth:
# contacts saturate early and so are alike, and what is weaker is the skin's skirt or noise (grey levels, ratio).
SHAPE_FLOOR, SHAPE_PART = 8.0, 0.4


def gather(change: F32, reach_cells: float) -> F32:
    """Screened Poisson solution ψ of ψ - ℓ² ∇²ψ = change: a mean over a neighbourhood of length ℓ.

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
    gathered: F32 = cv2.idct(spectrum)[:rows, :cols]
    return gathered


def gathered_change(maps: GreyMaps, reach_cells: float) -> tuple[F32, int]:
    """χ, in grey levels, 0 outside the disc; and how many cells were not finite and taken as 0."""
    g_d, repaired = _finite_change(maps)
    # Rounding of the transform may leave a little below zero.
    psi = np.maximum(gather(np.abs(g_d), reach_cells), 0)
    darkening = np.maximum(gather(np.maximum(-g_d, 0), reach_cells), 0) + np.float32(DARKENING_FLOOR)
    chi = psi ** np.float32(1 - DARKENING_WEIGHT) * darkening ** np.float32(DARKENING_WEIGHT)
    return np.where(maps.inside, chi, np.float32(0)).astype(np.float32), repaired


def brightening(maps: GreyMaps, reach_cells: float) -> F32:
    """What brightened inside the contacts, gathered so that it makes one patch of each; grey levels."""
    g_d, _ = _finite_change(maps)
    bright = np.maximum(g_d - np.float32(SHAPE_DEAD), 0)
    return np.maximum(gather(bright, SHAPE_REACH * reach_cells), 0)


def _finite_change(maps: GreyMaps) -> tuple[F32, int]:
    """g_d within its range, 0 outside the disc and where it is not finite; and how many cells were not."""
    finite = np.isfinite(maps.g_d)
    g_d = np.where(finite & maps.inside, np.clip(maps.g_d, -255, 255), np.float32(0)).astype(np.float32)
    return g_d, int(finite.size - np.count_nonzero(finite))


def solve(maps: GreyMaps, scale: DepthScale) -> Depth:
    """Height from the table at χ (clamped at its end), shaped by the brightening; or α · g_hn."""
    g_d, repaired = _finite_change(maps)
    if scale.table_grey.size == 0:
        height: F32 = np.float32(scale.alpha_mm) * shape_grey(g_d, maps.g0, maps.inside)
        return Depth(height, saturated=False, repaired_px=repaired)
    chi, _ = gathered_change(maps, scale.reach_cells)
    depth = np.interp(chi, scale.table_grey, scale.table_depth_mm).astype(np.float32)
    shape = brightening(maps, scale.reach_cells)
    side = 2 * max(round(NEIGHBOUR_REACH * scale.reach_cells), 1) + 1
    around = np.ones((side, side), dtype=np.uint8)
    floor = np.float32(max(SHAPE_FLOOR, SHAPE_PART * float(shape.max(initial=0.0))))
    height = scale.gain * cv2.dilate(depth, around) * shape / np.maximum(cv2.dilate(shape, around), floor)
    height = np.where(maps.inside, height, np.float32(0)).astype(np.float32)
    return Depth(height, saturated=bool((chi > scale.table_grey[-1]).any()), repaired_px=repaired)
