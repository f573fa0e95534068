"""The sampling grid, the visible disc on it, and the skin point that each pixel sees (eq. 2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from ...types.geometry import F32, F64, U16, Bool, Disc, Geometry, frozen

Value = TypeVar("Value", bound=np.generic)
USUAL_MM: Final = 8.0
"""Radius of the visible circle of the smallest sensors that people build for a hand."""


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
        """Cells in the middle of each whole stride of the image that lie in the window;
        at least one cell.
        """
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
    """The ray of each cell of a grid, and whether it lies in the disc. u, v: a pinhole's slopes
    (orthographic: x, y in mm).
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


def skin_points(height_mm: F32, rays: DiscRays, geometry: Geometry) -> F32:
    """Metric points of the skin along the camera's rays, float32 (..., 3); see `skin_planes`."""
    return np.ascontiguousarray(np.moveaxis(skin_planes(height_mm, rays, geometry), 0, -1))


def skin_planes(height_mm: F32, rays: DiscRays, geometry: Geometry) -> F32:
    """x, y and z of the skin along the camera's rays, float32 (3, ...), mm, from heights h, float32
    (...), at most r; NaN stays NaN. Eq. 2 for an orthographic camera; a pinhole's ray meets the
    sphere of radius r - h twice, and the skin is the farther root. A height that its ray cannot
    reach gives the ray's point nearest to the sphere. A pad's skin is the plane z = -h.
    """
    if geometry.skin == "pad":
        return _pad_planes(height_mm, rays, geometry)
    # Eq. 2: z = √(ρ² - x² - y²) on the sphere of radius ρ = r - h. Float32 errs by 2e-6 r² below
    # the root, so by 1.4e-3 r where a ray grazes the skin.
    rho = np.float32(geometry.skin_radius_mm) - height_mm
    u, v = rays.u, rays.v
    planes = np.empty((3, *rho.shape), np.float32)
    x, y, z = planes
    if geometry.camera_distance_mm is None:
        np.sqrt(np.maximum(rho * rho - (u * u + v * v), np.float32(0)), out=z)
        x[...], y[...] = np.where(np.isnan(z), z, u), np.where(np.isnan(z), z, v)
    else:
        d = np.float32(geometry.camera_distance_mm)
        slope2 = u * u + v * v
        k = 1 + slope2
        # |(s·u, s·v, s - d)| = rho  =>  k s² - 2 d s + d² - rho² = 0;
        # solved without subtracting d² terms.
        root = np.sqrt(np.maximum(k * (rho * rho) - d * d * slope2, np.float32(0)))
        s = (d + root) / k
        np.divide(root - d * slope2, k, out=z)
        np.multiply(s, u, out=x)
        np.multiply(s, v, out=y)
    return planes


def _pad_planes(height_mm: F32, rays: DiscRays, geometry: Geometry) -> F32:
    """`skin_planes` of a pad; a height beyond the lens gives the lens."""
    d = geometry.camera_distance_mm
    s = height_mm * 0 + np.float32(1) if d is None else np.maximum(np.float32(d) - height_mm, 0)
    return np.stack((s * rays.u, s * rays.v, -height_mm))


def point_heights(points_mm: F64, geometry: Geometry) -> F64:
    """Height h (N,) of points (N, 3) on the skin, mm; negative outside the undeformed skin."""
    if geometry.skin == "pad":
        return np.asarray(-points_mm[:, 2])
    return np.asarray(geometry.skin_radius_mm - np.linalg.norm(points_mm, axis=1))


def labels_by_cell(points_mm: F32, labels: U16, grid: Grid, geometry: Geometry) -> U16:
    """The labels (N,) of points (N, 3) of the skin at the cells whose rays pass nearest to them,
    (rows, cols); 0 at the other cells. Points outside the grid are ignored.
    """
    x, y, z = points_mm.astype(np.float64).T
    d_mm = geometry.camera_distance_mm
    with np.errstate(
        divide="ignore", over="ignore", invalid="ignore"
    ):  # a point next to the lens is ignored too
        px_per_mm = (
            np.full_like(z, 1.0 / geometry.mm_per_px)
            if d_mm is None
            else geometry.f_px / (z + d_mm)
        )
        i = np.rint((geometry.disc.row_c + y * px_per_mm - grid.row0) / grid.step_px)
        j = np.rint((geometry.disc.col_c + x * px_per_mm - grid.col0) / grid.step_px)
    inside = (i >= 0) & (i < grid.rows) & (j >= 0) & (j < grid.cols)
    by_cell = np.zeros((grid.rows, grid.cols), np.uint16)
    # Of two points at one cell the later stays: NumPy assigns in order.
    by_cell[i[inside].astype(np.intp), j[inside].astype(np.intp)] = labels[inside]
    return by_cell


def cell_area_mm2(planes_mm: F32) -> F32:
    """Area of skin of each cell of `skin_planes`, float32 (rows, cols), mm², by central
    differences; 0 where a neighbour is NaN.
    """
    along, across = (_steps(planes_mm, axis) for axis in (2, 1))
    # Component i of a cross product combines components i + 1 and i + 2.
    normal = along[1:4] * across[2:5]
    normal -= along[2:5] * across[1:4]
    normal *= normal
    area: F32 = np.add.reduce(normal, axis=0)
    # `fmax` takes the number beside a NaN, `maximum` would take the NaN.
    return np.fmax(np.sqrt(area, out=area), np.float32(0), out=area)


def least_area_mm2(usual_mm2: float, geometry: Geometry) -> float:
    """A least area, mm², that is `usual_mm2` on sensors of usual size, and on smaller ones the same
    part of what they see as on the smallest of those.
    """
    return usual_mm2 * min(1.0, (geometry.visible_radius_mm / USUAL_MM) ** 2)


def _steps(planes: F32, axis: int) -> F32:
    """Differences (5, rows, cols) of neighbours' x, y, z, x, y like ``np.gradient``,
    which takes four times as long.
    """
    steps = np.zeros((5, *planes.shape[1:]), np.float32)
    lines, out = planes.swapaxes(0, axis), steps[:3].swapaxes(0, axis)
    if len(lines) > 1:
        # One pass through memory, also across the ends,
        # which the one-sided differences then overwrite.
        flat, along, by = (
            planes.reshape(-1),
            steps[:3].reshape(-1),
            (planes.shape[2] if axis == 1 else 1),
        )
        np.subtract(flat[2 * by :], flat[: -2 * by], out=along[by:-by])
        along *= np.float32(0.5)
        np.subtract(lines[1], lines[0], out=out[0])
        np.subtract(lines[-1], lines[-2], out=out[-1])
    steps[3:] = steps[:2]
    return steps
