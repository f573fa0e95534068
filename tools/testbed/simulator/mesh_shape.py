"""An object from a closed surface of triangles, as in an STL file, as a signed distance on a grid.

A point is inside if a line along x from it crosses the surface an odd number of times.
"""

from __future__ import annotations

import numpy as np

from tacshade_edge.simulator.objects import Shape
from tacshade_edge.types import F32, F64

STEP_MM = 1.0
"""Step of the grid; edges are rounded by about a third of it."""
_BLOCK = 8
_BESIDE_MM = 4.0
_OFF_MM = np.array((0.0, 0.0137, 0.0271))  # keeps lines off corners at round coordinates


def mesh_shape(triangles_mm: F64, step_mm: float = STEP_MM) -> Shape:
    """Make a shape with the same origin as the triangles.

    Parameters
    ----------
    triangles_mm : float64 (N, 3, 3)
        A closed surface, counter-clockwise as seen from outside.
    step_mm : float
    """
    low = triangles_mm.min(axis=(0, 1)) - _BESIDE_MM - _OFF_MM
    counts = np.ceil((triangles_mm.max(axis=(0, 1)) + _BESIDE_MM - low) / step_mm).astype(int) + 1
    grid = _grid(triangles_mm, low, counts, step_mm)
    last = ((counts - 1) * step_mm).astype(np.float32)

    def sdf(p: F64) -> F64:
        on = np.clip(p - low, 0, last)
        beyond = np.linalg.norm(p - low - on, axis=1)
        at = on / step_mm
        first = np.minimum(at.astype(np.intp), counts - 2)
        part = at - first
        value = np.zeros(len(p), p.dtype)
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(corner, part, 1 - part), axis=1)
            value += weight * grid[tuple((first + corner).T)]
        # Outside the grid, the surface is at least the margin away from the grid's boundary.
        return np.where(beyond > 0, np.hypot(beyond, _BESIDE_MM), value).astype(p.dtype)

    return Shape("mesh", sdf)


def _grid(triangles: F64, low: F64, counts: np.typing.NDArray[np.int_], step_mm: float) -> F32:
    """Compute the distances at the grid's nodes by blocks, using only triangles that may be the nearest to a block."""
    grid = np.zeros(tuple(counts), np.float32)
    middle = triangles.mean(axis=1)
    reach = np.linalg.norm(triangles - middle[:, None], axis=2).max(axis=1)
    for block in np.ndindex(*-(-counts // _BLOCK)):
        slices = tuple(slice(b * _BLOCK, min((b + 1) * _BLOCK, n)) for b, n in zip(block, counts, strict=True))
        index = np.stack(np.meshgrid(*(np.arange(s.start, s.stop) for s in slices), indexing="ij"), axis=-1)
        nodes = (low + index * step_mm).reshape(-1, 3)
        centre = nodes.mean(axis=0)
        half = float(np.linalg.norm(nodes - centre, axis=1).max())
        away = np.linalg.norm(middle - centre, axis=1)
        near = away - reach <= float((away + reach).min()) + 2 * half
        distance = _to_triangles(nodes, triangles[near])
        grid[slices] = distance.reshape(index.shape[:3])
    return np.where(_inside(triangles, low, counts, step_mm), -grid, grid)


def _to_triangles(points: F64, triangles: F64) -> F64:
    """Compute the distance (P,) from points to the nearest triangle: to its plane if above it, otherwise to an edge."""
    best = np.full(len(points), np.inf)
    for a, b, c in triangles:
        normal = np.cross(b - a, c - a)
        beside = np.zeros(len(points), bool)
        for one, other in ((a, b), (b, c), (c, a)):
            edge, to = other - one, points - one
            part = np.clip(to @ edge / max(float(edge @ edge), 1e-12), 0, 1)
            best = np.minimum(best, np.linalg.norm(to - part[:, None] * edge, axis=1))
            beside |= to @ np.cross(edge, normal) > 0
        size = float(np.linalg.norm(normal))
        if size > 1e-12:
            best = np.where(beside, best, np.minimum(best, np.abs((points - a) @ normal) / size))
    return best


def _inside(
    triangles: F64, low: F64, counts: np.typing.NDArray[np.int_], step_mm: float
) -> np.typing.NDArray[np.bool_]:
    inside = np.zeros(tuple(counts), bool)
    x, y, z = (low[k] + np.arange(counts[k]) * step_mm for k in range(3))
    for triangle in triangles:
        first, last = (np.searchsorted(y, f(triangle[:, 1])) for f in (np.min, np.max))
        front, end = (np.searchsorted(z, f(triangle[:, 2])) for f in (np.min, np.max))
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = triangle
        area = (by - ay) * (cz - az) - (bz - az) * (cy - ay)
        if abs(area) < 1e-12 or first == last or front == end:
            continue
        u, v = np.meshgrid(y[first:last] - ay, z[front:end] - az, indexing="ij")
        b, c = (u * (cz - az) - v * (cy - ay)) / area, (v * (by - ay) - u * (bz - az)) / area
        crossing = np.where((b >= 0) & (c >= 0) & (b + c <= 1), ax + b * (bx - ax) + c * (cx - ax), -np.inf)
        inside[:, first:last, front:end] ^= x[:, None, None] < crossing
    return inside
