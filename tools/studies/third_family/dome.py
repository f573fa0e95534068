"""A soft dome: its parameters, drawn from two disjoint ranges, and its mesh of tetrahedra.

A rubber skin lies on a gel, which is bonded to a stiff core, the window in front of the camera; the rim is clamped.
Skin and gel are layers of tetrahedra over one triangulation of the sphere, fine at the tip and coarse at the rim.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import Delaunay

from tacshade_edge.simulator.model import RIM_HALF_ANGLE_DEG, SensorModel, random_model
from tacshade_edge.types import F64, I64

FINE_DEG = 26.0
"""Up to this angle from the tip, the mesh has its shortest edges; beyond, they grow towards the rim."""

COARSER = 3.0
"""Edges at the rim are longer by this multiple of the edges at the tip."""

RANGES: dict[str, dict[str, tuple[float, float]]] = {
    "working": {
        "skin_mm": (1.0, 1.7),
        "gel_part": (0.25, 0.35),
        "stiffness_ratio": (2.0, 5.0),
        "poisson": (0.42, 0.45),
        "friction": (0.6, 0.8),
    },
    "final": {
        "skin_mm": (1.7, 2.4),
        "gel_part": (0.35, 0.45),
        "stiffness_ratio": (5.0, 8.0),
        "poisson": (0.45, 0.47),
        "friction": (0.8, 1.0),
    },
}
"""Ranges from which domes are drawn. Nobody evaluates a network on ``final`` before all work on networks is done."""

FIRST_SEED = {"working": 31000, "final": 39000}
"""Seeds of the sensors' print, camera and light; no other family uses them."""


@dataclass(frozen=True, slots=True)
class Dome:
    """A skin on its gel.

    Attributes
    ----------
    radius_mm : float
        Radius of the skin's outside, which touches and which the camera is assumed to see.
    skin_mm : float
        Thickness of the skin.
    gel_part : float
        Thickness of the gel below the skin, as a part of the radius.
    stiffness_ratio : float
        Young's modulus of the skin over that of the gel; forces have no unit here, so the gel's modulus is 1.
    poisson : float
        Poisson's ratio of skin and gel.
    friction : float
        Coulomb's coefficient.
    """

    radius_mm: float
    skin_mm: float
    gel_part: float
    stiffness_ratio: float
    poisson: float
    friction: float


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Tetrahedra of a dome at rest.

    Attributes
    ----------
    points_mm : float64 (N, 3)
        Points in the sensor frame; the first `surface` ones are the skin's outside.
    surface : int
    skin, gel : int (M, 4)
        Corners of the tetrahedra, right-handed.
    clamped : bool (N,)
        Whether a point is at the rim or on the core.
    """

    points_mm: F64
    surface: int
    skin: I64
    gel: I64
    clamped: np.typing.NDArray[np.bool_]


def drawn(range_name: str, number: int) -> tuple[SensorModel, Dome]:
    """Draw a sensor: its print and camera as for the training family, its dome from a range."""
    seed = FIRST_SEED[range_name] + number
    model = random_model(seed)
    rng = np.random.default_rng((seed, 41))
    values = {name: float(rng.uniform(*span)) for name, span in RANGES[range_name].items()}
    # The skin itself contains the material's motion (`seen.deformed`), so the renderer must not add friction.
    return replace(model, friction=0.0), Dome(radius_mm=model.skin_radius_mm, **values)


def meshed(dome: Dome, edge_mm: float, gel_layers: int = 3) -> Mesh:
    """Fill a dome with tetrahedra whose edges at the tip have about the given length."""
    direction, triangles = cap(dome.radius_mm, edge_mm)
    count = len(direction)
    depths = np.linspace(0, 1, gel_layers + 1) ** 1.15 * dome.gel_part * dome.radius_mm + dome.skin_mm
    radii = dome.radius_mm - np.concatenate(((0.0,), depths))
    points = np.concatenate([direction * radius for radius in radii])
    rim = direction[:, 2] < math.cos(math.radians(RIM_HALF_ANGLE_DEG)) + 1e-9
    clamped = np.tile(rim, len(radii))
    clamped[-count:] = True
    layers = [_righted(points, _layer(triangles, count, k)) for k in range(len(radii) - 1)]
    return Mesh(points, count, layers[0], np.concatenate(layers[1:]), clamped)


def cap(radius_mm: float, edge_mm: float) -> tuple[F64, I64]:
    """Make unit vectors (N, 3) in rings from the tip to the rim, and triangles (M, 3) between them."""
    rim = math.radians(RIM_HALF_ANGLE_DEG)
    fine = math.radians(FINE_DEG)
    points, angle, ring = [(0.0, 0.0, 1.0)], 0.0, 0
    while angle < rim:
        edge = edge_mm * (1 + COARSER * max(0.0, (angle - fine) / (rim - fine)))
        angle += 0.87 * edge / radius_mm
        if angle > rim - 0.4 * edge / radius_mm:
            angle = rim
        ring += 1
        count = max(6, round(2 * math.pi * math.sin(angle) * radius_mm / edge))
        around = 2 * math.pi * np.arange(count) / count + 0.5 * ring
        points += [(math.sin(angle) * math.cos(a), math.sin(angle) * math.sin(a), math.cos(angle)) for a in around]
    direction = np.array(points)
    return direction, Delaunay(direction[:, :2] / (1 + direction[:, 2:])).simplices.astype(np.int64)


def volumes(points_mm: F64, corners: I64) -> F64:
    """Compute the signed volumes (M,) of tetrahedra in mm³."""
    p = points_mm[corners]
    a, b, c = (p[:, k] - p[:, 0] for k in (1, 2, 3))
    return np.asarray(np.einsum("ij,ij->i", np.cross(a, b), c) / 6)


def _layer(triangles: I64, count: int, outer: int) -> I64:
    """Cut the prisms between two layers into tetrahedra; sorted corners make the cuts of neighbours agree."""
    a, b, c = (np.sort(triangles, axis=1) + outer * count).T
    below = count
    return np.concatenate(
        [np.stack(corners, axis=1) for corners in (
            (a, b, c, c + below), (a, b, b + below, c + below), (a, a + below, b + below, c + below)
        )]
    )  # fmt: skip


def _righted(points: F64, corners: I64) -> I64:
    left = volumes(points, corners) < 0
    corners = corners.copy()
    corners[left] = corners[left][:, (1, 0, 2, 3)]
    return corners
