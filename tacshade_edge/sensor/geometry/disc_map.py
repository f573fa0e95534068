"""Maps on the disc-normalised grid: every sensor's visible circle fills the same square,
whatever its camera.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tacshade_edge.sensor.geometry.disc import DiscRays, Grid, cells_in_image, disc_rays
from tacshade_edge.types import F32, Calibration, Disc, Geometry

CELLS = 112
"""Default number of cells along a side."""

REACH = 1.02
"""Half the square's side, in radii of the disc."""


def map_grid(disc: Disc, cells: int = CELLS) -> Grid:
    """The cells of the map as a grid of image positions (their middles,
    which need not be whole pixels).
    """
    step = 2 * REACH * disc.radius_px / cells
    first = (0.5 - cells / 2) * step
    return Grid(
        rows=cells, cols=cells, row0=disc.row_c + first, col0=disc.col_c + first, step_px=step
    )


def geometry_maps(geometry: Geometry, pitch_px: float, cells: int = CELLS) -> F32:
    """What is known of a sensor before any frame, (6, cells, cells): x and y in disc radii; shift
    in x and y of the image of a skin point that moves by a disc radius towards the camera, in disc
    radii; cosine between ray and skin's normal; marker pitch in tenths of the disc's radius.
    """
    disc = geometry.disc
    axis = (np.arange(cells) + 0.5 - cells / 2) * (2 * REACH / cells)
    x, y = np.meshgrid(axis, axis)
    # The square reaches beyond the disc, where a steep skin's ray would miss the sphere.
    rho2 = np.minimum(x * x + y * y, 1.0)
    sin_half = np.sin(np.radians(geometry.visible_half_angle_deg))
    if geometry.skin == "pad":
        gain = np.full_like(x, geometry.visible_radius_mm / (geometry.camera_distance_mm or np.inf))
        cosine = 1 / np.sqrt(1 + rho2 * gain * gain)
    elif geometry.camera_distance_mm is None:
        gain = np.zeros_like(x)
        cosine = np.sqrt(1 - rho2 * sin_half**2)
    else:
        d = geometry.camera_distance_mm / geometry.skin_radius_mm
        slope2 = rho2 * (geometry.disc.radius_px / geometry.f_px) ** 2
        k = 1 + slope2
        # The ray's far intersection with the sphere, as z + d along the axis from the camera,
        # in skin radii.
        root = np.sqrt(np.maximum(d * d - k * (d * d - 1), 0))
        along = (d + root) / k
        gain = sin_half / along
        cosine = (along * k - d) / np.sqrt(k)
    # In the networks' unit of length, `learned.HEIGHT_SCALE`.
    pitch = np.full_like(x, 10 * pitch_px / disc.radius_px)
    return np.stack((x, y, gain * x, gain * y, cosine, pitch)).astype(np.float32)


def rays_in_image(grid: Grid, calibration: Calibration) -> DiscRays:
    """`disc_rays`, with cells of the disc beyond the image counted as outside."""
    rays = disc_rays(grid, calibration.geometry)
    in_image = cells_in_image(grid, calibration.image_height_px, calibration.image_width_px)
    return DiscRays(inside=rays.inside & in_image, u=rays.u, v=rays.v)


def with_finite_radius(geometry: Geometry) -> Geometry:
    """A pad with its size for a radius, for what compares sensors by their radii;
    a dome as it is.
    """
    if geometry.skin == "dome":
        return geometry
    return replace(geometry, skin_radius_mm=geometry.size_mm)


def skin_scale(geometry: Geometry) -> float:
    """The factor for a length stated for a skin of radius 20 mm (squared: for an area)."""
    return geometry.size_mm / 20
