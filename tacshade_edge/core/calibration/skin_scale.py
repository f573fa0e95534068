"""Scale lengths to a skin of any radius: a sensor scaled as a whole shows its camera the same images."""

from __future__ import annotations

from tacshade_edge.types import Geometry

NOMINAL_RADIUS_MM = 20.0
"""Radius of the skin for which this package states lengths and areas, mm."""


def skin_scale(geometry: Geometry) -> float:
    """The factor for a length stated for the nominal skin; for an area, its square."""
    return geometry.skin_radius_mm / NOMINAL_RADIUS_MM
