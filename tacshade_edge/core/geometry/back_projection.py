"""Compute the skin point that a pixel sees from the radial deformation there, eq. 2."""

from __future__ import annotations

import numpy as np

from ...types import F32, Bool, Geometry
from .disc import DiscRays, Grid


def skin_points(height_mm: F32, rays: DiscRays, geometry: Geometry) -> F32:
    """Metric points of the skin along the camera's rays, float32 (..., 3); see `skin_planes`."""
    return np.ascontiguousarray(np.moveaxis(skin_planes(height_mm, rays, geometry), 0, -1))


def skin_planes(height_mm: F32, rays: DiscRays, geometry: Geometry) -> F32:
    """x, y and z of the skin along the camera's rays, (3, ...), from heights h, at most r; NaN stays NaN.

    The paper's eq. 2 gives z from (x, y) under an orthographic camera. A pinhole's ray meets the sphere of radius r - h
    twice; the skin is the farther root. A radicand below zero (a height that its ray cannot reach) counts as 0, which
    gives the ray's point nearest to the sphere.
    """
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
        # |(s·u, s·v, s - d)| = rho  =>  k s² - 2 d s + d² - rho² = 0; solved without subtracting d² terms.
        root = np.sqrt(np.maximum(k * (rho * rho) - d * d * slope2, np.float32(0)))
        s = (d + root) / k
        np.divide(root - d * slope2, k, out=z)
        np.multiply(s, u, out=x)
        np.multiply(s, v, out=y)
    return planes


def cells_that_see(points_mm: F32, grid: Grid, geometry: Geometry) -> Bool:
    """Cells whose rays pass nearest to points (N, 3) of the skin, the inverse of `skin_points` without the heights;
    points outside the grid are ignored.
    """
    x, y, z = points_mm.astype(np.float64).T
    d_mm = geometry.camera_distance_mm
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # a point next to the lens is ignored too
        px_per_mm = np.full_like(z, 1.0 / geometry.mm_per_px) if d_mm is None else geometry.f_px / (z + d_mm)
        i = np.rint((geometry.disc.row_c + y * px_per_mm - grid.row0) / grid.step_px)
        j = np.rint((geometry.disc.col_c + x * px_per_mm - grid.col0) / grid.step_px)
    inside = (i >= 0) & (i < grid.rows) & (j >= 0) & (j < grid.cols)
    seen = np.zeros((grid.rows, grid.cols), np.bool_)
    seen[i[inside].astype(np.intp), j[inside].astype(np.intp)] = True
    return seen


def cell_area_mm2(planes_mm: F32) -> F32:
    """Area of skin that each cell of a grid of points (`skin_planes`) covers, by central differences; 0 where a
    neighbour is NaN.
    """
    along, across = (_steps(planes_mm, axis) for axis in (2, 1))
    # Component i of a cross product combines components i + 1 and i + 2.
    normal = along[1:4] * across[2:5]
    normal -= along[2:5] * across[1:4]
    normal *= normal
    area: F32 = np.add.reduce(normal, axis=0)
    return np.fmax(np.sqrt(area, out=area), np.float32(0), out=area)


def _steps(planes: F32, axis: int) -> F32:
    """Differences (5, rows, cols) of neighbours' x, y, z, x, y like ``np.gradient``, which takes four times as long."""
    steps = np.zeros((5, *planes.shape[1:]), np.float32)
    lines, out = planes.swapaxes(0, axis), steps[:3].swapaxes(0, axis)
    if len(lines) > 1:
        # One pass through memory, also across the ends, which the one-sided differences then overwrite.
        flat, along, by = planes.reshape(-1), steps[:3].reshape(-1), (planes.shape[2] if axis == 1 else 1)
        np.subtract(flat[2 * by :], flat[: -2 * by], out=along[by:-by])
        along *= np.float32(0.5)
        np.subtract(lines[1], lines[0], out=out[0])
        np.subtract(lines[-1], lines[-2], out=out[-1])
    steps[3:] = steps[:2]
    return steps
