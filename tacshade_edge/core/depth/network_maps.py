"""Maps into and out of the networks: folded, on the disc-normalised grid, lengths in tenths of the disc's radius."""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.core.geometry import disc_map
from tacshade_edge.types import F32, Geometry

KNOWN = 6
"""Number of maps of `disc_map.geometry_maps`."""

HEIGHT_SCALE = 10.0
"""Number of the networks' units of length in the disc's radius."""


def scale_mm(geometry: Geometry) -> np.float32:
    """The factor from the networks' lengths to mm."""
    unit_mm = geometry.skin_radius_mm * math.sin(math.radians(geometry.visible_half_angle_deg))
    return np.float32(unit_mm / HEIGHT_SCALE)


def known_maps(geometry: Geometry, pitch_px: float, reference_white: F32, by: int) -> F32:
    """The maps of what is known of a sensor, (by² + KNOWN, N / by, N / by)."""
    known = disc_map.geometry_maps(geometry, pitch_px, len(reference_white))
    return np.concatenate((fold(reference_white[None], by), known[:, ::by, ::by]))


def fold(maps: F32, by: int) -> F32:
    """Fold (C, N, N) to (by² C, N/by, N/by): each square of by x by cells becomes by² channels."""
    c, n, _ = maps.shape
    part = n // by
    folded = maps.reshape(c, part, by, part, by).transpose(0, 2, 4, 1, 3)
    return np.ascontiguousarray(folded).reshape(by * by * c, part, part)


def unfold(maps: F32, by: int) -> F32:
    """Invert `fold`: (by² C, N/by, N/by) to (C, N, N)."""
    c, part, _ = maps.shape
    unfolded = maps.reshape(c // by**2, by, by, part, part).transpose(0, 3, 1, 4, 2)
    return np.ascontiguousarray(unfolded).reshape(c // by**2, by * part, by * part)
