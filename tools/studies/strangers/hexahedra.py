"""Linear hexahedra of a dome's layers: their mesh,
and the stiffness of nearly incompressible layers.

Each hexahedron has eight corners, strains are small, and its change of volume is averaged (the
B-bar method), so that rubber whose Poisson's ratio is close to one half does not lock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from tacshade_edge.types import F64, I64
from tools.studies.strangers import grid


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """A layer of one material, from outside to inside."""

    thickness_mm: float
    parts: int  # hexahedra across it
    young: float
    poisson: float


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Hexahedra of a dome."""

    points_mm: F64  # (N, 3); the first `surface` ones are the skin's outside
    surface: int
    corners: I64  # (M, 8)
    young: F64  # (M,)
    poisson: F64  # (M,)
    held: I64  # the points on the core


def meshed(
    radius_mm: float, layers: tuple[Layer, ...], square: int = grid.SQUARE, rings: int = grid.RINGS
) -> Mesh:
    """Fill a spherical dome with layers over a core."""
    direction, quads = grid.directions(square, rings)
    radii, young, poisson = [radius_mm], [], []
    for layer in layers:
        for _ in range(layer.parts):
            radii.append(radii[-1] - layer.thickness_mm / layer.parts)
            young += [layer.young] * len(quads)
            poisson += [layer.poisson] * len(quads)
    count = len(direction)
    points = np.concatenate([direction * radius for radius in radii])
    # Corners run around the inner face first, so that volumes are positive.
    corners = [
        np.concatenate((quads + count * (k + 1), quads + count * k), axis=1)
        for k in range(len(radii) - 1)
    ]
    held = np.arange(count * (len(radii) - 1), count * len(radii))
    return Mesh(points, count, np.concatenate(corners), np.array(young), np.array(poisson), held)


_SIGNS = np.array(
    (
        (-1, -1, -1),
        (1, -1, -1),
        (1, 1, -1),
        (-1, 1, -1),
        (-1, -1, 1),
        (1, -1, 1),
        (1, 1, 1),
        (-1, 1, 1),
    )
)
_AT = _SIGNS / math.sqrt(3)


def _gradients(points: F64) -> tuple[F64, F64]:
    """Gradients (M, 8 places, 8 corners, 3) of the shape functions, and weights (M,
    8 places) in mm³.
    """
    slopes = np.empty((8, 8, 3))
    for place, at in enumerate(_AT):
        each = 1 + _SIGNS * at
        for axis in range(3):
            others = [k for k in range(3) if k != axis]
            slopes[place, :, axis] = _SIGNS[:, axis] * each[:, others].prod(axis=1) / 8
    jacobian = np.einsum("gai,maj->mgij", slopes, points)
    gradients = np.einsum("mgij,gaj->mgai", np.linalg.inv(jacobian), slopes)
    return gradients, np.linalg.det(jacobian)


def stiffness(mesh: Mesh) -> sparse.csc_matrix:
    """Assemble the stiffness (3 N, 3 N) of the whole mesh, without its supports.

    Raises ValueError (folded).
    """
    gradients, weights = _gradients(mesh.points_mm[mesh.corners])
    if weights.min() <= 0:
        raise ValueError("a hexahedron is folded")
    shear = mesh.young / (2 * (1 + mesh.poisson))
    bulk = mesh.young / (3 * (1 - 2 * mesh.poisson))
    mean = np.einsum("mg,mgai->mai", weights, gradients) / weights.sum(axis=1)[:, None, None]
    volume = weights.sum(axis=1)
    inner = np.einsum("mg,mgak,mgbk->mab", weights, gradients, gradients)
    crossed = np.einsum("mg,mgaj,mgbi->maibj", weights, gradients, gradients)
    own = np.einsum("mg,mgai,mgbj->maibj", weights, gradients, gradients)
    made = crossed - 2 / 3 * own
    for axis in range(3):
        made[:, :, axis, :, axis] += inner
    made *= shear[:, None, None, None, None]
    made += (bulk * volume)[:, None, None, None, None] * np.einsum("mai,mbj->maibj", mean, mean)
    degrees = (3 * mesh.corners[:, :, None] + np.arange(3)).reshape(len(mesh.corners), 24)
    rows, cols = np.repeat(degrees, 24, axis=1).ravel(), np.tile(degrees, (1, 24)).ravel()
    size = 3 * len(mesh.points_mm)
    return sparse.csc_matrix((made.reshape(-1), (rows, cols)), shape=(size, size))
