"""White of a tactile image, Fig. 4(b): binarise in uint8 and reused buffers,
and sum over boxes of any size.
"""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from tacshade_edge.sensor.geometry.disc import Grid, Window
from tacshade_edge.types import F32, F64, I32, U8, Binarisation

A = TypeVar("A", U8, F32)
Total = npt.NDArray[np.int32] | npt.NDArray[np.float64]
"""An integral image of a window with zeros around it:
exact sums over the rows before i and the columns before j.
"""

ADAPTIVE_PITCHES = 4
"""Side of the adaptive threshold's neighbourhood in marker pitches: wide enough to hold black and
white everywhere, narrow enough to follow vignetting.
"""

ADAPTIVE_FLOOR = 0.6
"""Part of the disc's mean grey below which nothing is white, however dark its surroundings."""

# The threshold is slightly above the mean, so that a uniform surface is black however the products
# round.
_MORE = np.float32(1 / 64)

BLOCK_PX = 4
"""Side of the blocks whose means form the local mean."""


def odd(size: float) -> int:
    """Round to the nearest odd whole number, at least 1, so that a box has a middle."""
    return max(2 * round((size - 1) / 2) + 1, 1)


_WHOLE = 255  # the mean of a mask over a block that it covers


class Binariser:
    """Binarises grey images of one disc, `mask` 0 or 1.

    ``adaptive`` compares with the local mean inside the disc: the mean over a box of
    `ADAPTIVE_PITCHES` of means of 4x4 px blocks, interpolated linearly; within 2 levels, as two
    halvings and the interpolation round. ``global`` compares with the disc's mean, ``otsu`` with
    its best split.
    """

    def __init__(self, mask: U8, method: Binarisation, pitch_px: float) -> None:
        self._shape = mask.shape
        self._method = method
        self._inside = padded(mask, BLOCK_PX, 0)
        self._opaque: U8 = np.multiply(self._inside, 255, dtype=np.uint8)
        self._masked, self._white, self._threshold = (np.zeros_like(self._inside) for _ in range(3))
        self._box = (odd(ADAPTIVE_PITCHES * pitch_px / BLOCK_PX),) * 2
        # A block partly outside the disc would round to another mean.
        self._whole: U8 = np.where(_quarter(self._opaque) == _WHOLE, np.uint8(255), np.uint8(0))
        count = self._sums(self._whole) / np.float32(255)
        self._per_box: F32 = np.divide(
            np.float32(1), count, out=np.zeros_like(count), where=count > 0
        )
        self._blocks = cv2.countNonZero(self._whole)

    def __call__(self, grey: U8) -> U8:
        """Binarise an image of the mask's shape: 1 where white, 0 outside the disc;
        the next call overwrites it.
        """
        rows, cols = self._shape
        cv2.bitwise_and(grey, self._opaque[:rows, :cols], dst=self._masked[:rows, :cols])
        if self._method == "adaptive":
            parts = cv2.bitwise_and(_quarter(self._masked), self._whole)
            local = self._sums(parts)
            local *= self._per_box
            local += _MORE
            least = ADAPTIVE_FLOOR * cv2.sumElems(parts)[0] / max(self._blocks, 1)
            # For a whole number grey, grey > t is grey > floor(t); no t comes near 256.
            whole = np.maximum(local, np.float32(least)).astype(np.uint8)
            # EXACT: the same levels on every processor.
            cv2.resize(
                whole,
                self._masked.shape[::-1],
                dst=self._threshold,
                interpolation=cv2.INTER_LINEAR_EXACT,
            )
            cv2.compare(self._masked, self._threshold, cv2.CMP_GT, dst=self._white)
        else:
            cv2.threshold(self._masked, self._split(), 255, cv2.THRESH_BINARY, dst=self._white)
        cv2.bitwise_and(self._white, self._inside, dst=self._white)
        return self._white[:rows, :cols]

    def _sums(self, parts: U8) -> F32:
        return np.asarray(
            cv2.boxFilter(
                parts, cv2.CV_32F, self._box, normalize=False, borderType=cv2.BORDER_CONSTANT
            ),
            np.float32,
        )

    def _split(self) -> float:
        inside = self._masked[self._inside > 0].reshape(-1, 1)
        if not inside.size:
            return 255.0
        if self._method == "global":
            return float(inside.mean())
        return float(cv2.threshold(inside, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0])


def binarise(grey: U8, mask: U8, method: Binarisation, pitch_px: float) -> U8:
    """Binarise a single image; see `Binariser`."""
    return Binariser(mask, method, pitch_px)(grey)


def padded(image: U8, multiple: int, value: int) -> U8:
    """Pad an image with `value` below and on the right,
    so that its sides are multiples of `multiple`.
    """
    rows, cols = (-size % multiple for size in image.shape)
    if rows == cols == 0:
        return image
    return np.asarray(
        cv2.copyMakeBorder(image, 0, rows, 0, cols, cv2.BORDER_CONSTANT, value=value), np.uint8
    )


def halved(image: A) -> A:
    """Means over 2x2 px, rounded half up for uint8; the sides must be even.

    OpenCV has a fast path for this.
    """
    half: A = cv2.resize(
        image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA
    )
    return half


def eighth(image: U8) -> U8:
    """Means over whole squares of 8x8 px, each halving rounded."""
    rows, cols = (size // 8 for size in image.shape)
    return (
        halved(_quarter(image[: 8 * rows, : 8 * cols]))
        if rows and cols
        else np.zeros((rows, cols), np.uint8)
    )


def squares(image: U8, side_px: int) -> tuple[F32, F32]:
    """Mean and deviation of whole squares of pixels, float32 (rows, cols)."""
    rows, cols = (size // side_px for size in image.shape)
    if not rows or not cols:
        return (np.zeros((rows, cols), np.float32),) * 2
    values = image[: side_px * rows, : side_px * cols].astype(np.float32)
    mean, square = (
        cv2.resize(v, (cols, rows), interpolation=cv2.INTER_AREA) for v in (values, values * values)
    )
    return np.asarray(mean, np.float32), np.sqrt(np.maximum(square - mean * mean, np.float32(0)))


def _quarter(image: U8) -> U8:
    return halved(halved(image))


def median(values: F32 | F64) -> float:
    """The median of at least one value, none of them NaN;
    the mean of the middle two for an even number.
    """
    low, high = (values.size - 1) // 2, values.size // 2
    ordered = values.copy()
    ordered.partition((low, high))  # np.partition does the same, but first checks its arguments
    return (float(ordered[low]) + float(ordered[high])) / 2


def level_at(values: U8, mask: U8, part: float) -> float:
    """The grey level that this part of the values in a mask (255 inside) does not exceed;
    0 for an empty mask.
    """
    if not values.size:
        return 0.0
    counts = cv2.calcHist([values], [0], mask, [256], [0, 256]).ravel().cumsum()
    return float(np.searchsorted(counts, part * counts[-1])) if counts[-1] else 0.0


_EXACT = 2**31
"""Integrals below this are exact in int32."""


class Integrator:
    """Makes the integral images of a window's pixels.

    `margin_px`: greatest reach of a box beyond the window.
    """

    def __init__(self, window: Window, margin_px: int) -> None:
        self.window = window
        self.margin_px = margin_px
        self._values = np.zeros(
            (window.rows + 2 * margin_px, window.cols + 2 * margin_px), np.uint8
        )

    def space(self) -> I32:
        """Allocate the buffer for one integral image."""
        rows, cols = self._values.shape
        return np.empty((rows + 1, cols + 1), np.int32)

    def integrate(self, values: U8, space: I32 | None = None) -> Total:
        """Integrate an image of the window; the result may use `space`,
        and then lasts until `space` is used again.
        """
        rows, cols, m = self.window.rows, self.window.cols, self.margin_px
        self._values[m : m + rows, m : m + cols] = values
        if values.size < _EXACT // 255 or int(values.max()) * values.size < _EXACT:
            return np.asarray(cv2.integral(self._values, space, cv2.CV_32S), np.int32)
        return np.asarray(cv2.integral(self._values, sdepth=cv2.CV_64F), np.float64)


class BoxSums:
    """Sums integral images over boxes of odd side around the cells of a grid
    of whole pixels inside the window.
    """

    def __init__(self, integrator: Integrator, grid: Grid, side_px: int) -> None:
        half, self._step = side_px // 2, int(grid.step_px)
        row = int(grid.row0) - integrator.window.row0 + integrator.margin_px
        col = int(grid.col0) - integrator.window.col0 + integrator.margin_px
        self._rows, self._cols = grid.rows, grid.cols
        self._above, self._below = row - half, row + half + 1
        self._left, self._right = col - half, col + half + 1
        self._bands: Total = np.empty((0, 0), np.int32)  # work space

    def sums(self, total: Total) -> F32:
        """The sums, float32 (grid.rows, grid.cols), exact below 2**24."""
        step = self._step
        if self._bands.shape[1] != total.shape[1] or self._bands.dtype != total.dtype:
            self._bands = np.empty((self._rows, total.shape[1]), total.dtype)
        below, above = total[self._below :: step], total[self._above :: step]
        bands = np.subtract(below[: self._rows], above[: self._rows], out=self._bands)
        sums = (
            bands[:, self._right :: step][:, : self._cols]
            - bands[:, self._left :: step][:, : self._cols]
        )
        return sums.astype(np.float32)


class CellMeans:
    """Averages over a grid's cells, as wide as its step, whose edges may cut pixels:
    squares of constant value.
    """

    def __init__(self, integrator: Integrator, grid: Grid) -> None:
        window, m = integrator.window, integrator.margin_px
        self._rows = _Edges(grid.row0 - window.row0, grid.step_px, grid.rows, window.rows, m)
        self._cols = _Edges(grid.col0 - window.col0, grid.step_px, grid.cols, window.cols, m)
        self._per_area = np.float32(1 / grid.step_px**2)

    def means(self, total: Total) -> F32:
        """The means, float32 (rows, cols), exact to 1e-4 of the greatest value;
        pixels beyond the window are 0.
        """
        both = self._cols.across(self._rows.between(total))
        return np.multiply(both.T, self._per_area, order="C")


class _Edges:
    """Edges of cells along an axis of an integral image:
    `_part` of the way from a line to the next.
    """

    def __init__(self, first: float, step: float, count: int, size: int, margin: int) -> None:
        # Pixel i spans i - 0.5 to i + 0.5, and row i of an integral image is the sum up to i - 0.5.
        edge = np.clip(first + step * (np.arange(count + 1) - 0.5) + 0.5, 0, size) + margin
        low = np.minimum(edge.astype(np.int32), size + 2 * margin - 1).astype(np.int32)
        self._both = np.concatenate((low, low + 1))
        self._part = (edge - low).astype(np.float32)[:, None]
        self._taken: Total | F32 = np.empty((0, 0), np.float32)
        self._turned: F32 = np.empty((0, 0), np.float32)

    def between(self, lines: Total | F32) -> F32:
        """Integrate along axis 0 from each edge to the next, differences first, which are exact in
        float32; the next call overwrites the result.
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
