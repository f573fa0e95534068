"""Sums of an image over boxes of any size, all from one integral image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from tacshade_edge.core.geometry.disc import Grid, Window
from tacshade_edge.types import F32, I32, U8

Total = npt.NDArray[np.int32] | npt.NDArray[np.float64]

_EXACT = 2**31
"""Integrals below it are exact in int32."""


class Sums:
    """The integral image of a window's pixels, with zeros around it; of one image at a time.

    Exact: whole numbers in int32 (float64 where an image of grey levels is so large that they would not fit).

    Parameters
    ----------
    window : Window
    margin_px : int
        How far a box may reach beyond the window.
    """

    def __init__(self, window: Window, margin_px: int) -> None:
        self.window = window
        self._margin = margin_px
        shape = (window.rows + 2 * margin_px, window.cols + 2 * margin_px)
        self._values = np.zeros(shape, np.uint8)
        self._total: Total = np.zeros((shape[0] + 1, shape[1] + 1), np.int32)
        self._bands: Total = self._total[:0]  # space to work in

    def show(self, values: U8) -> None:
        """Take an image of the window, uint8 (rows, cols); what follows is of this one."""
        rows, cols, m = self.window.rows, self.window.cols, self._margin
        self._values[m : m + rows, m : m + cols] = values
        if values.size < _EXACT // 255 or int(values.max()) * values.size < _EXACT:
            if self._total.dtype != np.int32:
                self._total = np.zeros(self._total.shape, np.int32)
            cv2.integral(self._values, self._total, cv2.CV_32S)
        else:
            self._total = cv2.integral(self._values, sdepth=cv2.CV_64F)

    def boxes(self, grid: Grid, side_px: int) -> F32:
        """Sums over boxes of an odd side around the cells of a grid of whole pixels inside the window.

        Returns
        -------
        float32 (grid.rows, grid.cols)
            Exact below 2**24.
        """
        half, step = side_px // 2, int(grid.step_px)
        row = int(grid.row0) - self.window.row0 + self._margin
        col = int(grid.col0) - self.window.col0 + self._margin
        if len(self._bands) != grid.rows or self._bands.dtype != self._total.dtype:
            self._bands = np.empty((grid.rows, self._total.shape[1]), self._total.dtype)
        below, above = self._total[row + half + 1 :: step], self._total[row - half :: step]
        bands = np.subtract(below[: grid.rows], above[: grid.rows], out=self._bands)
        sums = bands[:, col + half + 1 :: step][:, : grid.cols] - bands[:, col - half :: step][:, : grid.cols]
        return sums.astype(np.float32)

    def means(self, cells: Cells) -> F32:
        """Means over cells whose edges need not lie between pixels, as if a pixel were a square of one value.

        Returns
        -------
        float32 (cells.rows, cells.cols)
            Exact to 1e-4 of the greatest value. What lies beyond the window is 0.
        """
        both = cells.cols.across(cells.rows.between(self._total))
        return np.multiply(both.T, np.float32(1 / cells.area_px2), order="C")

    def cells_of(self, grid: Grid) -> Cells:
        """Prepare `means` over the cells of a grid."""
        rows, cols, m = self.window.rows, self.window.cols, self._margin
        row_edges = _edges(grid.row0 - self.window.row0, grid.step_px, grid.rows, rows, m)
        return Cells(row_edges, _edges(grid.col0 - self.window.col0, grid.step_px, grid.cols, cols, m), grid.step_px**2)


class Edges:
    """Where the edges of cells in a row lie in an integral image: between line `low` and the next, at `part` of it.

    Parameters
    ----------
    low : int32 (n + 1,)
    part : float32 (n + 1,)
    """

    def __init__(self, low: I32, part: F32) -> None:
        self._both = np.concatenate((low, low + 1))
        self._part = part[:, None]
        self._taken: Total | F32 = np.empty((0, 0), np.float32)
        self._turned: F32 = np.empty((0, 0), np.float32)

    def between(self, lines: Total | F32) -> F32:
        """Integral along axis 0 from each edge to the next; the next call overwrites it.

        Differences first: they are small, and exact in float32.
        """
        edges, width = len(self._part), lines.shape[1]
        if self._taken.shape[1] != width or self._taken.dtype != lines.dtype:
            self._taken = np.empty((2 * edges, width), lines.dtype)
            self._steps = np.empty((edges - 1, width), lines.dtype)
            self._parts = np.repeat(self._part, width, axis=1)
            self._beyond = np.empty((edges, width), np.float32)
            self._between = np.empty((edges - 1, width), np.float32)
        # "clip" writes into `out` directly; no edge lies beyond.
        taken = lines.take(self._both, 0, self._taken, "clip")
        at, following = taken[:edges], taken[edges:]
        self._beyond[...] = np.subtract(following, at, out=following)
        self._beyond *= self._parts
        self._between[...] = np.subtract(at[1:], at[:-1], out=self._steps)
        self._between += self._beyond[1:]
        self._between -= self._beyond[:-1]
        return self._between

    def across(self, lines: F32) -> F32:
        """The same along axis 1; axis 0 of the answer."""
        if self._turned.shape != lines.shape[::-1]:
            self._turned = np.empty(lines.shape[::-1], np.float32)
        cv2.transpose(lines, dst=self._turned)
        return self.between(self._turned)


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Cells of a grid in an integral image."""

    rows: Edges
    cols: Edges
    area_px2: float


def _edges(first: float, step: float, count: int, size: int, margin: int) -> Edges:
    # Pixel i reaches from i - 0.5 to i + 0.5, and row i of an integral image is the sum up to i - 0.5.
    edge = np.clip(first + step * (np.arange(count + 1) - 0.5) + 0.5, 0, size) + margin
    low = np.minimum(edge.astype(np.int32), size + 2 * margin - 1).astype(np.int32)
    return Edges(low, (edge - low).astype(np.float32))
