"""Pads, and the domes that tend to them."""

from __future__ import annotations

import math

from tacshade_edge.types import Disc, Geometry

DISC = Disc(61.3, 83.9, 47.7)


def pad(lens_mm: float | None, radius_mm: float = 15.0) -> Geometry:
    return Geometry(math.inf, lens_mm, 0.0, DISC, radius_mm)


def dome_like(flat: Geometry, r_mm: float) -> Geometry:
    """The dome of radius r whose visible circle is as large and as far from the lens
    as the pad's.
    """
    half = math.asin(flat.visible_radius_mm / r_mm)
    d = flat.camera_distance_mm
    lens = None if d is None else d - r_mm * math.cos(half)
    return Geometry(r_mm, lens, math.degrees(half), DISC)
