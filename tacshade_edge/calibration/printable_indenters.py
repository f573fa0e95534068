"""A set of indenters to print, and presses to take with them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tacshade_edge.calibration.indenters import SIDES, circle, level, surface
from tacshade_edge.types import F64, frozen

STEM_RADIUS_MM, LENGTH_MM = 4.0, 45.0
"""Radius of every stem, and length of every indenter from its lowest point to the stem's end."""
_SHOULDER_MM = 6.0  # the shape goes straight up at least this far: no press is deeper
_REACH_MM, _DEPTHS_MM = 9.0, (0.8, 1.6, 2.4, 3.2, 4.0)
_NECK = 0.6  # radius of a small ball's neck, in its radii
# Tips and edges have faces without area, which a slicer calls a defect of the mesh.
_LEAST_AREA_MM2 = 1e-12
_STEPS = 48  # rings of a shape that is round below


@frozen
class Printable:
    """An indenter to print: its entry in INDENTERS.yaml;
    its triangles, counter-clockwise from outside; stem up.
    """

    name: str
    entry: Mapping[str, str | float]
    triangles_mm: F64


def printables() -> tuple[Printable, ...]:
    """Make the indenters for a skin of radius 20 mm:
    balls, flat ends, a square, a lying bar, a cone.
    """
    made = []
    for radius_mm in (3.0, 6.0, 9.0):
        neck_mm = min(STEM_RADIUS_MM, _NECK * radius_mm)
        polar = np.linspace(0, math.pi - math.asin(neck_mm / radius_mm), _STEPS).tolist()
        rings = [
            level(circle(radius_mm * math.sin(a)), radius_mm * (1 - math.cos(a))) for a in polar
        ]
        rings.append(level(circle(neck_mm), float(rings[-1][0, 2]) + _SHOULDER_MM))
        made.append(
            _on_a_stem(f"ball_{radius_mm:g}", {"shape": "ball", "radius_mm": radius_mm}, rings)
        )
    for radius_mm in (3.0, 5.0):
        rings = [level(circle(radius_mm), z) for z in (0.0, _SHOULDER_MM)]
        made.append(
            _on_a_stem(f"flat_{radius_mm:g}", {"shape": "cylinder", "radius_mm": radius_mm}, rings)
        )
    rings = [level(_rectangle(6.0, 6.0), z) for z in (0.0, _SHOULDER_MM)]
    made.append(_on_a_stem("square_6", {"shape": "box", "length_mm": 6.0, "width_mm": 6.0}, rings))
    # A bar is round below its axis and keeps its full width above.
    polar = np.linspace(0, math.pi / 2, _STEPS).tolist()
    rings = [level(_rectangle(14.0, 4.0 * math.sin(a)), 2.0 * (1 - math.cos(a))) for a in polar]
    rings.append(level(_rectangle(14.0, 4.0), _SHOULDER_MM))
    made.append(_on_a_stem("bar_2", {"shape": "bar", "radius_mm": 2.0, "length_mm": 14.0}, rings))
    rings = [level(circle(r), z) for r, z in ((0.0, 0.0), (_SHOULDER_MM, _SHOULDER_MM))]
    made.append(_on_a_stem("cone_90", {"shape": "cone", "angle_deg": 90.0}, rings))
    return tuple(made)


@dataclass(frozen=True, slots=True)
class Planned:
    """A press to take: name of the indenter, place and depth in mm."""

    name: str
    x_mm: float
    y_mm: float
    depth_mm: float


def planned_presses() -> tuple[Planned, ...]:
    """Plan five presses with each of `printables`,
    whose places form a sunflower out to `_REACH_MM` (Vogel 1979).
    """
    names = [each.name for each in printables()]
    count, golden = len(names) * len(_DEPTHS_MM), math.pi * (3 - math.sqrt(5))
    presses = []
    for which, name in enumerate(names):
        for turn in range(len(_DEPTHS_MM)):
            # Neighbours of the spiral go to different indenters, so each covers the whole disc.
            k = which + len(names) * turn
            rho_mm = _REACH_MM * math.sqrt((k + 0.5) / count)
            x_mm, y_mm = (
                # A stage is set to 0.1 mm.
                round(rho_mm * part, 1)
                for part in (math.cos(k * golden), math.sin(k * golden))
            )
            presses.append(
                Planned(name, x_mm, y_mm, _DEPTHS_MM[(turn + 2 * which) % len(_DEPTHS_MM)])
            )
    return tuple(presses)


def _on_a_stem(name: str, entry: Mapping[str, str | float], rings: list[F64]) -> Printable:
    top_mm = float(rings[-1][0, 2])
    stem = [level(circle(STEM_RADIUS_MM), z) for z in (top_mm, LENGTH_MM)]
    triangles = surface([*rings, *stem])
    a, b, c = np.moveaxis(triangles, 1, 0)
    solid = np.linalg.norm(np.cross(b - a, c - a), axis=1) > _LEAST_AREA_MM2
    return Printable(name, entry, triangles[solid])


def _rectangle(length_mm: float, width_mm: float) -> F64:
    """Corners (SIDES, 2) on a rectangle around the origin, counter-clockwise from x,
    like `circle`.
    """
    angle = 2 * math.pi * np.arange(SIDES) / SIDES
    unit = np.column_stack((np.cos(angle), np.sin(angle)))
    on_square = unit / np.abs(unit).max(axis=1, keepdims=True)
    return np.asarray(on_square * (length_mm / 2, width_mm / 2))
