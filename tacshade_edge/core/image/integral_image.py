"""Sum an image over boxes of any size, all from one integral image."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from tacshade_edge.core.geometry.disc import Grid, Window
from tacshade_edge.types import F32, I32, U8, frozen

Total = npt.NDArray[np.int32] | npt.NDArray[np.float64]

_EXACT = 2**31
"""Integrals below this are exact in int32."""


@frozen
class IntegralImage:
    """The integral image of a window's pixels, with zeros around them.

    Exact: whole numbers in int32 (float64 if the image is too large for that).

    Attributes
    ----------
    total : int32 or float64 (rows + 2 margin + 1, cols + 2 margin + 1)
        Element (i, j) is the sum over the rows before i and the columns before j.
    """

    total: Total


class Integrator:
    """Makes the integral images of a window's pixels.

    Parameters
    ----------
    window : Window
    margin_px : int
        Greatest reach of a box beyond the window.
    """

    def __init__(self, window: Window, margin_px: int) -> None:
        self.window = window
        self.margin_px = margin_px
        self._values = np.zeros((window.rows + 2 * margin_px, window.cols + 2 * margin_px), np.uint8)

    def space(self) -> I32:
        """Allocate the buffer for one integral image."""
        rows, cols = self._values.shape
        return np.empty((rows + 1, cols + 1), np.int32)

    def integrate(self, values: U8, space: I32 | None = None) -> IntegralImage:
        """Integrate an image of the window.

        Parameters
        ----------
        values : uint8 (rows, cols)
        space : int32, optional
            Buffer from `space` that the result uses if it fits, valid until `space` is used again.
        """
        rows, cols, m = self.window.rows, self.window.cols, self.margin_px
        self._values[m : m + rows, m : m + cols] = values
        if values.size < _EXACT // 255 or int(values.max()) * values.size < _EXACT:
            return IntegralImage(np.asarray(cv2.integral(self._values, space, cv2.CV_32S), np.int32))
        return IntegralImage(np.asarray(cv2.integral(self._values, sdepth=cv2.CV_64F), np.float64))


class BoxSums:
    """Sums integral images over boxes of odd side around the cells of a grid of whole pixels inside the window.

    Parameters
    ----------
    integrator : Integrator
        Source of the integral images; its margin is more than half the side.
    grid : Grid
    side_px : int
    """

    def __init__(self, integrator: Integrator, grid: Grid, side_px: int) -> None:
        half, self._step = side_px // 2, int(grid.step_px)
        row = int(grid.row0) - integrator.window.row0 + integrator.margin_px
        col = int(grid.col0) - integrator.window.col0 + integrator.margin_px
        self._rows, self._cols = grid.rows, grid.cols
        self._above, self._below = row - half, row + half + 1
        self._left, self._right = col - half, col + half + 1
        self._bands: Total = np.empty((0, 0), np.int32)  # work space

    def sums(self, integral: IntegralImage) -> F32:
        """The sums, float32 (grid.rows, grid.cols), exact below 2**24."""
        total, step = integral.total, self._step
        if self._bands.shape[1] != total.shape[1] or self._bands.dtype != total.dtype:
            self._bands = np.empty((self._rows, total.shape[1]), total.dtype)
        below, above = total[self._below :: step], total[self._above :: step]
        bands = np.subtract(below[: self._rows], above[: self._rows], out=self._bands)
        sums = bands[:, self._right :: step][:, : self._cols] - bands[:, self._left :: step][:, : self._cols]
        return sums.astype(np.float32)


class CellMeans:
    """Averages over cells whose edges may cut pixels, which count as squares of constant value.

    Parameters
    ----------
    integrator : Integrator
        Source of the integral images.
    grid : Grid
        Its cells are as wide as its step.
    """

    def __init__(self, integrator: Integrator, grid: Grid) -> None:
        window, m = integrator.window, integrator.margin_px
        self._rows = _edges(grid.row0 - window.row0, grid.step_px, grid.rows, window.rows, m)
        self._cols = _edges(grid.col0 - window.col0, grid.step_px, grid.cols, window.cols, m)
        self._per_area = np.float32(1 / grid.step_px**2)

    def means(self, integral: IntegralImage) -> F32:
        """The means, float32 (grid.rows, grid.cols).

        Exact to 1e-4 of the greatest value. Pixels beyond the window are 0.
        """
        both = self._cols.across(self._rows.between(integral.total))
        return np.multiply(both.T, self._per_area, order="C")


class _Edges:
    """Positions of cell edges along an axis of an integral image: `part` of the way from line `low` to the next.

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
        """Integrate along axis 0 from each edge to the next; the next call overwrites the result.

        It takes differences first, because they are small and exact in float32.
        """
        edges, width = len(self._part), lines.shape[1]
        if self._taken.shape[1] != width or self._taken.dtype != lines.dtype:
            self._taken = np.empty((2 * edges, width), lines.dtype)
            self._steps = np.empty((edges - 1, width), lines.dtype)
            self._parts = np.repeat(self._part, width, axis=1)
            self._beyond = np.empty((edges, width), np.float32)
            self._between = np.empty((edges - 1, width), np.float32)
        # "clip" writes into `out` directly; no edge exceeds the range.
        taken = lines.take(self._both, 0, self._taken, "clip")
        at, following = taken[:edges], taken[edges:]
        self._beyond[...] = np.subtract(following, at, out=following)
        self._beyond *= self._parts
        self._between[...] = np.subtract(at[1:], at[:-1], out=self._steps)
        self._between += self._beyond[1:]
        self._between -= self._beyond[:-1]
        return self._between

    def across(self, lines: F32) -> F32:
        """Integrate along axis 1, which becomes axis 0 of the result."""
        if self._turned.shape != lines.shape[::-1]:
            self._turned = np.empty(lines.shape[::-1], np.float32)
        cv2.transpose(lines, dst=self._turned)
        return self.between(self._turned)


def _edges(first: float, step: float, count: int, size: int, margin: int) -> _Edges:
    # Pixel i spans i - 0.5 to i + 0.5, and row i of an integral image is the sum up to i - 0.5.
    edge = np.clip(first + step * (np.arange(count + 1) - 0.5) + 0.5, 0, size) + margin
    low = np.minimum(edge.astype(np.int32), size + 2 * margin - 1).astype(np.int32)
    return _Edges(low, (edge - low).astype(np.float32))
