"""Lengths for a skin of any radius: a sensor that is scaled as a whole shows its camera the same images."""

from __future__ import annotations

from tacshade_edge.types import Geometry

NOMINAL_RADIUS_MM = 20.0
"""The skin for which the lengths and areas of this room are stated."""


def skin_scale(geometry: Geometry) -> float:
    """What a length stated for the nominal skin is multiplied by; an area by its square."""
    return geometry.skin_radius_mm / NOMINAL_RADIUS_MM
