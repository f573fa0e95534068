"""The cheapest thing that is right: calibrated depth from gathered grey change, or α · g_hn without a calibration.

The white ratio follows the skin's local shape, not its depth: under a flat it has risen all it can at 0.5 mm, so no
table of g_d itself tells 1 mm from 5. What does grow with depth is how much skin changed, brighter or darker. So the
depth of a contact comes from a table of |g_d| gathered around it, and its shape from the brightening inside it.
"""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.core.greyscale import shape_grey
from tacshade_edge.core.solvers.base import Depth, DepthScale, GreyMaps
from tacshade_edge.types import F32

# The reach of the gathering, in skin radii: 4.4 mm on a skin of 20 mm. A longer one finds wide objects too deep, a
# shorter one small ones too flat.
REACH_RADII = 0.22
# The brightening is gathered over this part of it, so that the bright spots between pins make one patch.
SHAPE_REACH = 0.4
# A patch whose gathered brightening stays below this is noise, and keeps its small share (grey levels).
SHAPE_FLOOR = 8.0


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
    """ψ of |g_d|, in grey levels, 0 outside the disc; and how many cells were not finite and taken as 0."""
    finite = np.isfinite(maps.g_d)
    repaired = int(finite.size - np.count_nonzero(finite))
    change = np.where(finite & maps.inside, np.abs(maps.g_d), np.float32(0))
    # Rounding of the transform may leave a little below zero.
    psi = np.where(maps.inside, np.maximum(gather(np.minimum(change, np.float32(255)), reach_cells), 0), np.float32(0))
    return psi.astype(np.float32), repaired


def solve(maps: GreyMaps, scale: DepthScale) -> Depth:
    """Height from the table at ψ (clamped at its end), shaped by the brightening; or α · g_hn."""
    if scale.table_grey.size == 0:
        finite = np.isfinite(maps.g_d)
        g_d = np.where(finite, maps.g_d, np.float32(0))
        height: F32 = np.float32(scale.alpha_mm) * shape_grey(g_d, maps.g0, maps.inside)
        return Depth(height, saturated=False, repaired_px=int(finite.size - np.count_nonzero(finite)))
    psi, repaired = gathered_change(maps, scale.reach_cells)
    depth = np.interp(psi, scale.table_grey, scale.table_depth_mm).astype(np.float32) * scale.gain
    brightening = np.where(maps.inside & np.isfinite(maps.g_d), np.clip(maps.g_d, 0, 255), np.float32(0))
    shape = np.maximum(gather(brightening.astype(np.float32), SHAPE_REACH * scale.reach_cells), 0)
    # Each contact's brightest place gets the depth of its neighbourhood.
    side = 2 * max(round(scale.reach_cells), 1) + 1
    around = np.ones((side, side), dtype=np.uint8)
    height = cv2.dilate(depth, around) * shape / np.maximum(cv2.dilate(shape, around), np.float32(SHAPE_FLOOR))
    height = np.where(maps.inside, height, np.float32(0)).astype(np.float32)
    return Depth(height, saturated=bool((psi > scale.table_grey[-1]).any()), repaired_px=repaired)
