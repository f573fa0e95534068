"""The rays of a sensor's camera inside its image."""

from __future__ import annotations

from tacshade_edge.core.geometry.disc import DiscRays, Grid, cells_in_image, disc_rays
from tacshade_edge.types import Calibration


def rays_in_image(grid: Grid, calibration: Calibration) -> DiscRays:
    """`disc_rays`, with cells of the disc beyond the image counted as outside."""
    rays = disc_rays(grid, calibration.geometry)
    in_image = cells_in_image(grid, calibration.image_height_px, calibration.image_width_px)
    return DiscRays(inside=rays.inside & in_image, u=rays.u, v=rays.v)
