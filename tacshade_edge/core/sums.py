"""Sums of an image over boxes of any size, all from one integral image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from tacshade_edge.core.disc import Grid, Window
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
        bands = self._total[row + half + 1 :: step][: grid.rows] - self._total[row - half :: step][: grid.rows]
        sums = bands[:, col + half + 1 :: step][:, : grid.cols] - bands[:, col - half :: step][:, : grid.cols]
        return sums.astype(np.float32)

    def means(self, cells: Cells) -> F32:
        """Means over cells whose edges need not lie between pixels, as if a pixel were a square of one value.

        Returns
        -------
        float32 (cells.rows, cells.cols)
            Exact to 1e-4 of the greatest value. What lies beyond the window is 0.
        """
        bands = _between(self._total, cells.row_low, cells.row_part[:, None])
        both = _between(np.ascontiguousarray(bands.T), cells.col_low, cells.col_part[:, None])
        return np.ascontiguousarray(both.T) * np.float32(1 / cells.area_px2)

    def cells_of(self, grid: Grid) -> Cells:
        """Prepare `means` over the cells of a grid."""
        rows, cols, m = self.window.rows, self.window.cols, self._margin
        row_low, row_part = _edges(grid.row0 - self.window.row0, grid.step_px, grid.rows, rows, m)
        col_low, col_part = _edges(grid.col0 - self.window.col0, grid.step_px, grid.cols, cols, m)
        return Cells(row_low, row_part, col_low, col_part, grid.step_px**2)


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Where the edges of a grid's cells lie in an integral image: between row `low` and the next, at `part` of it."""

    row_low: I32
    row_part: F32
    col_low: I32
    col_part: F32
    area_px2: float


def _edges(first: float, step: float, count: int, size: int, margin: int) -> tuple[I32, F32]:
    # Pixel i reaches from i - 0.5 to i + 0.5, and row i of an integral image is the sum up to i - 0.5.
    edge = np.clip(first + step * (np.arange(count + 1) - 0.5) + 0.5, 0, size) + margin
    low = np.minimum(edge.astype(np.int32), size + 2 * margin - 1).astype(np.int32)
    return low, (edge - low).astype(np.float32)


def _between(total: Total | F32, low: I32, part: F32) -> F32:
    """Integral along axis 0 from each edge to the next. Differences first: they are small, and exact in float32."""
    at, following = total.take(low, axis=0), total.take(low + 1, axis=0)
    # int32 times float32 would be float64.
    beyond = (following - at).astype(np.float32) * part
    between: F32 = (at[1:] - at[:-1]).astype(np.float32)
    between += beyond[1:]
    between -= beyond[:-1]
    return between
