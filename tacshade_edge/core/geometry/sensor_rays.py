"""The rays of a sensor's camera, as far as its image goes."""

from __future__ import annotations

from tacshade_edge.core.geometry.disc import DiscRays, Grid, cells_in_image, disc_rays
from tacshade_edge.types import Calibration


def rays_in_image(grid: Grid, calibration: Calibration) -> DiscRays:
    """`disc_rays`; what the image cuts off the disc is outside."""
    rays = disc_rays(grid, calibration.geometry)
    in_image = cells_in_image(grid, calibration.image_height_px, calibration.image_width_px)
    return DiscRays(inside=rays.inside & in_image, u=rays.u, v=rays.v)
