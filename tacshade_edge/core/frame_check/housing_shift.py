"""How far the picture moved against its housing: by what lies around the visible circle."""

from __future__ import annotations

import math
from typing import cast

import cv2
import numpy as np

from tacshade_edge.core.geometry.disc import Grid, radius_squared
from tacshade_edge.core.image.median import median
from tacshade_edge.types import F32, U8, Disc

CELL_PX = 4
"""The housing is compared in squares of so many of the camera's pixels: a shift of as many is still linear there."""
TEXTURE_LEVELS = 1.0
"""Root mean square of the housing's grey steps from cell to cell, along its plainest axis, from which it tells."""
LEAST_CELLS = 100
FAR = 1.6
"""In radii of the disc: what lies beyond is not looked at."""


class HousingShift:
    """The shift of the surround, by least squares (Lucas and Kanade 1981) with Huber's weights (1964).

    Within a fifth of the shift or 0.3 px of the camera, up to 7 px, in other light and on a camera that warms up.

    Parameters
    ----------
    reference_grey : uint8 (H, W)
    disc : Disc
    cell_px : int
        In pixels of the image.

    Attributes
    ----------
    tells : bool
        Whether the surround has enough texture along both axes.
    """

    def __init__(self, reference_grey: U8, disc: Disc, cell_px: int) -> None:
        self._cell_px = cell_px
        cells = self._cells(reference_grey)
        rows, cols = cells.shape
        grid = Grid(rows, cols, (cell_px - 1) / 2, (cell_px - 1) / 2, cell_px)
        rho2 = radius_squared(grid, disc)
        # A cell of its own width away, and its neighbours, show no skin.
        least = (1 + 2.5 * cell_px / disc.radius_px) ** 2
        around = (rho2 > least) & (rho2 < FAR**2)
        around[[0, -1]] = around[:, [0, -1]] = False
        around[::2, ::2] = around[1::2, 1::2] = False  # a half of them tells as much
        self._at = np.flatnonzero(around)
        self.tells = len(self._at) >= LEAST_CELLS
        if not self.tells:
            return
        shown, (down, across) = cells.take(self._at), (each.take(self._at) for each in np.gradient(cells))
        i, j = np.unravel_index(self._at, cells.shape)
        # From the disc's centre, in its radii: the shift is that of the centre.
        row = (grid.row0 + i * cell_px - disc.row_c) / disc.radius_px
        col = (grid.col0 + j * cell_px - disc.col_c) / disc.radius_px
        # Moved, grown as it warms up, and lit otherwise, from another side too.
        grown, light = across * col + down * row, (shown, shown * row, shown * col, np.ones_like(shown))
        self._model = np.stack((across, down, grown, *light)).astype(np.float32)
        self._space = np.empty_like(self._model)
        texture = self._model[:2] @ self._model[:2].T / len(self._at)
        self.tells = float(np.linalg.eigvalsh(texture)[0]) >= TEXTURE_LEVELS**2

    def measure_px(self, grey: U8) -> float:
        """How far the surround moved, in pixels of the image."""
        found = self._cells(grey).take(self._at)
        weight, weighted = np.ones_like(found), self._space
        for _ in range(3):
            np.multiply(self._model, weight, out=weighted)
            fit = np.linalg.lstsq(weighted @ self._model.T, weighted @ found, rcond=None)[0].astype(np.float32)
            off = np.abs(found - fit @ self._model)
            most = 1.5 * median(off) + 0.5
            weight = np.asarray(most / np.maximum(off, most), np.float32)
        return math.hypot(fit[0], fit[1]) / max(float(fit[3]), 0.05) * self._cell_px

    def _cells(self, grey: U8) -> F32:
        rows, cols = (side // self._cell_px for side in grey.shape)
        part = grey[: rows * self._cell_px, : cols * self._cell_px]
        if not part.size:
            return np.zeros((1, 1), np.float32)
        means = cv2.resize(part, (cols, rows), interpolation=cv2.INTER_AREA)
        return cast(F32, cv2.GaussianBlur(means.astype(np.float32), (0, 0), 0.7))
