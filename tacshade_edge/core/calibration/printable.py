"""Make closed surfaces of indenters to print, each on a stem for a press to hold, and plan presses with them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.calibration.indenters import SIDES, circle, level, surface
from tacshade_edge.types import F64, frozen

STEM_RADIUS_MM, LENGTH_MM = 4.0, 45.0
"""Radius of every stem, and length of every indenter from its lowest point to the stem's end."""

_SHOULDER_MM = 6.0  # the shape goes straight up at least this far: no press is deeper
_REACH_MM, _DEPTHS_MM = 9.0, (0.8, 1.6, 2.4, 3.2, 4.0)
_NECK = 0.6  # radius of a small ball's neck, in its radii
_STEPS = 48  # rings of a shape that is round below


@frozen
class Printable:
    """An indenter to print: its entry in INDENTERS.yaml, and its triangles (N, 3, 3), counter-clockwise from outside;
    the lowest point has z = 0, the stem points along z.
    """

    name: str
    entry: Mapping[str, str | float]
    triangles_mm: F64


def printables() -> tuple[Printable, ...]:
    """Make the indenters for a skin of radius 20 mm: balls, flat ends, a square, a lying bar, a cone."""
    return (
        *(_ball(radius_mm) for radius_mm in (3.0, 6.0, 9.0)),
        *(_flat(radius_mm) for radius_mm in (3.0, 5.0)),
        _square(6.0),
        _bar(2.0, 14.0),
        _cone(90.0),
    )


@dataclass(frozen=True, slots=True)
class Planned:
    """A press to take: name of the indenter, place and depth in mm."""

    name: str
    x_mm: float
    y_mm: float
    depth_mm: float


def planned_presses() -> tuple[Planned, ...]:
    """Plan five presses with each of `printables`: all places form a sunflower out to `_REACH_MM` (Vogel 1979), those
    of each indenter spread over all of it.
    """
    names = [each.name for each in printables()]
    count, golden = len(names) * len(_DEPTHS_MM), math.pi * (3 - math.sqrt(5))
    presses = []
    for which, name in enumerate(names):
        for turn in range(len(_DEPTHS_MM)):
            k = which + len(names) * turn
            rho_mm = _REACH_MM * math.sqrt((k + 0.5) / count)
            x_mm, y_mm = (round(rho_mm * part, 1) for part in (math.cos(k * golden), math.sin(k * golden)))
            presses.append(Planned(name, x_mm, y_mm, _DEPTHS_MM[(turn + 2 * which) % len(_DEPTHS_MM)]))
    return tuple(presses)


def _ball(radius_mm: float) -> Printable:
    entry: dict[str, str | float] = {"shape": "ball", "radius_mm": radius_mm}
    neck_mm = min(STEM_RADIUS_MM, _NECK * radius_mm)
    polar = np.linspace(0, math.pi - math.asin(neck_mm / radius_mm), _STEPS)
    rings = [level(circle(radius_mm * math.sin(a)), radius_mm * (1 - math.cos(a))) for a in polar.tolist()]
    rings.append(level(circle(neck_mm), float(rings[-1][0, 2]) + _SHOULDER_MM))
    return _on_a_stem(f"ball_{radius_mm:g}", entry, rings)


def _flat(radius_mm: float) -> Printable:
    entry: dict[str, str | float] = {"shape": "cylinder", "radius_mm": radius_mm}
    return _on_a_stem(f"flat_{radius_mm:g}", entry, [level(circle(radius_mm), z) for z in (0.0, _SHOULDER_MM)])


def _square(side_mm: float) -> Printable:
    entry: dict[str, str | float] = {"shape": "box", "length_mm": side_mm, "width_mm": side_mm}
    rings = [level(_rectangle(side_mm, side_mm), z) for z in (0.0, _SHOULDER_MM)]
    return _on_a_stem(f"square_{side_mm:g}", entry, rings)


def _bar(radius_mm: float, length_mm: float) -> Printable:
    """A bar that is round below its axis and keeps its full width above."""
    entry: dict[str, str | float] = {"shape": "bar", "radius_mm": radius_mm, "length_mm": length_mm}
    polar = np.linspace(0, math.pi / 2, _STEPS).tolist()
    rings = [level(_rectangle(length_mm, 2 * radius_mm * math.sin(a)), radius_mm * (1 - math.cos(a))) for a in polar]
    return _on_a_stem(f"bar_{radius_mm:g}", entry, [*rings, level(_rectangle(length_mm, 2 * radius_mm), _SHOULDER_MM)])


def _cone(angle_deg: float) -> Printable:
    entry: dict[str, str | float] = {"shape": "cone", "angle_deg": angle_deg}
    wide_mm = math.tan(math.radians(angle_deg) / 2) * _SHOULDER_MM
    return _on_a_stem(
        f"cone_{angle_deg:g}", entry, [level(circle(r), z) for r, z in ((0.0, 0.0), (wide_mm, _SHOULDER_MM))]
    )


def _on_a_stem(name: str, entry: Mapping[str, str | float], rings: list[F64]) -> Printable:
    top_mm = float(rings[-1][0, 2])
    stem = [level(circle(STEM_RADIUS_MM), z) for z in (top_mm, LENGTH_MM)]
    triangles = surface([*rings, *stem])
    a, b, c = np.moveaxis(triangles, 1, 0)
    solid = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-12  # tips and edges have faces without area
    return Printable(name, entry, triangles[solid])


def _rectangle(length_mm: float, width_mm: float) -> F64:
    """Corners (SIDES, 2) on a rectangle around the origin, counter-clockwise from x, like `circle`."""
    angle = 2 * math.pi * np.arange(SIDES) / SIDES
    unit = np.column_stack((np.cos(angle), np.sin(angle)))
    on_square = unit / np.abs(unit).max(axis=1, keepdims=True)
    return np.asarray(on_square * (length_mm / 2, width_mm / 2))
