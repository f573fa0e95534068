"""The sampling grid and the visible disc on it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from ...types import F32, Bool, Disc, Geometry, frozen

Value = TypeVar("Value", bound=np.generic)


@dataclass(frozen=True, slots=True)
class Window:
    """The working part of an image: `rows` from `row0` on, `cols` from `col0` on."""

    row0: int
    col0: int
    rows: int
    cols: int

    @classmethod
    def of_disc(cls, height_px: int, width_px: int, disc: Disc) -> Window:
        """The smallest window around the disc's part in the image; at least one pixel."""
        row0, rows = _span(disc.row_c, disc.radius_px, height_px)
        col0, cols = _span(disc.col_c, disc.radius_px, width_px)
        return cls(row0, col0, rows, cols)

    def cut(self, image: npt.NDArray[Value]) -> npt.NDArray[Value]:
        """A view of the window's pixels."""
        return image[self.row0 : self.row0 + self.rows, self.col0 : self.col0 + self.cols]


def _span(centre: float, radius: float, size: int) -> tuple[int, int]:
    first = min(max(math.floor(centre - radius), 0), size - 1)
    last = min(max(math.ceil(centre + radius), first), size - 1)
    return first, last - first + 1


@dataclass(frozen=True, slots=True)
class Grid:
    """Cell (i, j) is image pixel (row0 + i·step_px, col0 + j·step_px)."""

    rows: int
    cols: int
    row0: float
    col0: float
    step_px: float

    @classmethod
    def of_window(cls, window: Window, step_px: int) -> Grid:
        """Cells in the middle of each whole stride of the image that lie in the window; at least one cell."""
        row0, rows = _cells(window.row0, window.rows, step_px)
        col0, cols = _cells(window.col0, window.cols, step_px)
        return cls(rows=rows, cols=cols, row0=float(row0), col0=float(col0), step_px=float(step_px))


def _cells(first: int, size: int, step: int) -> tuple[int, int]:
    k = -(-(first - step // 2) // step)
    cell = k * step + step // 2
    if cell > first + size - 1:
        return first + (size - 1) // 2, 1
    return cell, (first + size - 1 - cell) // step + 1


@frozen
class DiscRays:
    """The ray of each cell of a grid, and whether its pixel lies in the visible disc. u, v are the slope of a pinhole's
    ray (mm per mm of z); orthographic, the ray's x and y in mm.
    """

    inside: Bool
    u: F32
    v: F32

    def part(self, cells: tuple[slice, slice]) -> DiscRays:
        """The rays of a range of rows and columns of the grid."""
        return DiscRays(inside=self.inside[cells], u=self.u[cells], v=self.v[cells])


def disc_mask(height_px: int, width_px: int, disc: Disc) -> Bool:
    """Pixels whose centre lies in the visible circle (the paper's circular mask)."""
    rows = np.arange(height_px)[:, None] - disc.row_c
    cols = np.arange(width_px)[None, :] - disc.col_c
    mask: Bool = rows * rows + cols * cols <= disc.radius_px**2
    return mask


def cells_in_image(grid: Grid, height_px: int, width_px: int) -> Bool:
    """Cells of a grid with their middle inside the image: bool (rows, cols)."""
    rows = grid.row0 + grid.step_px * np.arange(grid.rows)
    cols = grid.col0 + grid.step_px * np.arange(grid.cols)
    # Pixel i spans i - 0.5 to i + 0.5.
    seen: Bool = (np.abs(rows - (height_px - 1) / 2) <= height_px / 2)[:, None] & (
        np.abs(cols - (width_px - 1) / 2) <= width_px / 2
    )[None, :]
    return seen


def radius_squared(grid: Grid, disc: Disc) -> F32:
    """ρ² of every cell, with ρ the distance from the disc's centre in its radii."""
    rows = (grid.row0 + grid.step_px * np.arange(grid.rows))[:, None] - disc.row_c
    cols = (grid.col0 + grid.step_px * np.arange(grid.cols))[None, :] - disc.col_c
    rho2: F32 = ((rows * rows + cols * cols) / disc.radius_px**2).astype(np.float32)
    return rho2


def disc_rays(grid: Grid, geometry: Geometry) -> DiscRays:
    """The camera's ray for every cell of `grid`."""
    rows = (grid.row0 + grid.step_px * np.arange(grid.rows))[:, None] - geometry.disc.row_c
    cols = (grid.col0 + grid.step_px * np.arange(grid.cols))[None, :] - geometry.disc.col_c
    inside = rows * rows + cols * cols <= geometry.disc.radius_px**2
    per_px = geometry.mm_per_px if geometry.camera_distance_mm is None else 1.0 / geometry.f_px
    shape = (grid.rows, grid.cols)
    u = np.broadcast_to((cols * per_px).astype(np.float32), shape)
    v = np.broadcast_to((rows * per_px).astype(np.float32), shape)
    return DiscRays(inside=inside, u=np.ascontiguousarray(u), v=np.ascontiguousarray(v))
