"""Eq. 2: the skin point that a pixel sees, from the radial deformation there."""

from __future__ import annotations

import numpy as np

from tacshade_edge.core.disc import DiscRays
from tacshade_edge.types import F32, Geometry


def skin_points(height_mm: F32, rays: DiscRays, geometry: Geometry) -> tuple[F32, int]:
    """Metric points of the skin along the camera's rays.

    The paper's eq. 2 gives z from (x, y) under an orthographic camera. A pinhole's ray meets the sphere of
    radius r - h twice; the skin is the farther root. A radicand below zero (a height that its ray cannot
    reach) is taken as 0, the nearest point that the ray has to the sphere, and counted.

    Parameters
    ----------
    height_mm : float32 (...)
        h, at most r; NaN stays NaN.
    rays : DiscRays
        With the shape of `height_mm`.
    geometry : Geometry

    Returns
    -------
    points_mm : float32 (..., 3)
    guarded : int
        Points whose radicand was negative.
    """
    rho = np.float32(geometry.skin_radius_mm) - height_mm
    u, v = rays.u, rays.v
    if geometry.camera_distance_mm is None:
        radicand = rho * rho - (u * u + v * v)
        z = np.sqrt(np.maximum(radicand, 0))
        x, y = np.where(np.isnan(z), z, u), np.where(np.isnan(z), z, v)
    else:
        d = np.float32(geometry.camera_distance_mm)
        slope2 = u * u + v * v
        k = 1 + slope2
        # |(s·u, s·v, s - d)| = rho  =>  k s² - 2 d s + d² - rho² = 0; solved so that no d² is taken from another.
        radicand = k * (rho * rho) - d * d * slope2
        root = np.sqrt(np.maximum(radicand, 0))
        s, z = (d + root) / k, (root - d * slope2) / k
        x, y = s * u, s * v
    points: F32 = np.stack([x, y, z], axis=-1).astype(np.float32, copy=False)
    return points, int(np.count_nonzero(radicand < 0))


def cell_area_mm2(points_mm: F32) -> F32:
    """Area of skin that each cell of a grid of points stands for.

    Parameters
    ----------
    points_mm : float32 (rows, cols, 3)

    Returns
    -------
    float32 (rows, cols)
        By central differences; 0 where a neighbour is NaN.
    """
    x_y_z = np.ascontiguousarray(points_mm.transpose(2, 0, 1))
    (ax, ay, az), (bx, by, bz) = (_steps(x_y_z, axis) for axis in (2, 1))
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    area: F32 = np.fmax(np.sqrt(x * x + y * y + z * z), np.float32(0))
    return area


def _steps(values: F32, axis: int) -> F32:
    """Differences of neighbours along an axis as of ``np.gradient``, which takes four times as long."""
    lines = values.swapaxes(0, axis)
    steps = np.zeros_like(lines)
    if len(lines) > 1:
        np.subtract(lines[2:], lines[:-2], out=steps[1:-1])
        steps *= np.float32(0.5)
        steps[0], steps[-1] = lines[1] - lines[0], lines[-1] - lines[-2]
    return steps.swapaxes(0, axis)
