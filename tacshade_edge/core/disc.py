"""The sampling grid and the visible disc on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tacshade_edge.types import F32, Bool, Disc, Geometry, freeze


@dataclass(frozen=True, slots=True)
class Grid:
    """Cell (i, j) is image pixel (row0 + i·step_px, col0 + j·step_px)."""

    rows: int
    cols: int
    row0: float
    col0: float
    step_px: float

    @classmethod
    def of_image(cls, height_px: int, width_px: int, step_px: int) -> Grid:
        """Cover an image with cells in the middle of each stride; whole strides only, at least one cell."""
        rows, cols = max(height_px // step_px, 1), max(width_px // step_px, 1)
        # An image narrower than half a stride still holds its one cell.
        row0, col0 = (float(min(step_px // 2, size - 1)) for size in (height_px, width_px))
        return cls(rows=rows, cols=cols, row0=row0, col0=col0, step_px=float(step_px))


@dataclass(frozen=True, slots=True, eq=False)
class DiscRays:
    """Where each cell of a grid looks.

    Attributes
    ----------
    inside : bool (rows, cols)
        Cells whose pixel lies in the visible disc.
    u, v : float32 (rows, cols)
        Pinhole: slope of the ray in x and y (mm per mm of z). Orthographic: x and y of the ray in mm.
    """

    inside: Bool
    u: F32
    v: F32

    def __post_init__(self) -> None:
        freeze(self, "inside", "u", "v")

    def part(self, cells: tuple[slice, slice]) -> DiscRays:
        """The rays of some rows and columns of the grid."""
        return DiscRays(inside=self.inside[cells], u=self.u[cells], v=self.v[cells])


def disc_mask(height_px: int, width_px: int, disc: Disc) -> Bool:
    """Pixels whose centre lies in the visible circle (the paper's circular mask).

    Returns
    -------
    bool (height_px, width_px)
    """
    rows = np.arange(height_px)[:, None] - disc.row_c
    cols = np.arange(width_px)[None, :] - disc.col_c
    mask: Bool = rows * rows + cols * cols <= disc.radius_px**2
    return mask


def cells_in_image(grid: Grid, height_px: int, width_px: int) -> Bool:
    """Cells of a grid whose middle some pixel covers: bool (rows, cols)."""
    rows = grid.row0 + grid.step_px * np.arange(grid.rows)
    cols = grid.col0 + grid.step_px * np.arange(grid.cols)
    # Pixel i reaches from i - 0.5 to i + 0.5.
    seen: Bool = (np.abs(rows - (height_px - 1) / 2) <= height_px / 2)[:, None] & (
        np.abs(cols - (width_px - 1) / 2) <= width_px / 2
    )[None, :]
    return seen


def radius_squared(grid: Grid, disc: Disc) -> F32:
    """ρ² of every cell, ρ the distance from the disc's centre in its radii."""
    rows = (grid.row0 + grid.step_px * np.arange(grid.rows))[:, None] - disc.row_c
    cols = (grid.col0 + grid.step_px * np.arange(grid.cols))[None, :] - disc.col_c
    rho2: F32 = ((rows * rows + cols * cols) / disc.radius_px**2).astype(np.float32)
    return rho2


def disc_rays(grid: Grid, geometry: Geometry) -> DiscRays:
    """Rays of the design's camera for every cell of `grid`."""
    rows = (grid.row0 + grid.step_px * np.arange(grid.rows))[:, None] - geometry.disc.row_c
    cols = (grid.col0 + grid.step_px * np.arange(grid.cols))[None, :] - geometry.disc.col_c
    inside = rows * rows + cols * cols <= geometry.disc.radius_px**2
    per_px = geometry.mm_per_px if geometry.camera_distance_mm is None else 1.0 / geometry.f_px
    shape = (grid.rows, grid.cols)
    u = np.broadcast_to((cols * per_px).astype(np.float32), shape)
    v = np.broadcast_to((rows * per_px).astype(np.float32), shape)
    return DiscRays(inside=inside, u=np.ascontiguousarray(u), v=np.ascontiguousarray(v))
