"""Objects to hold: signed distances in mm in a frame at the object's centre, exact outside."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tacshade_edge.simulator.objects import Shape, polygon
from tacshade_edge.types import F64


def box(x_mm: float, y_mm: float, z_mm: float, rounding_mm: float = 2.0) -> Shape:
    """A box of these total lengths with rounded edges."""
    half = np.array((x_mm, y_mm, z_mm)) / 2 - rounding_mm
    if not half.min() >= 0:
        raise ValueError(f"a box of {x_mm} x {y_mm} x {z_mm} mm has no edges of radius {rounding_mm} mm")

    def sdf(p: F64) -> F64:
        beyond = np.abs(p) - half.astype(p.dtype)
        outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
        return np.asarray(outside + np.minimum(beyond.max(axis=1), 0) - np.float32(rounding_mm))

    return Shape("box", sdf)


def cylinder(radius_mm: float, length_mm: float, rounding_mm: float = 2.0) -> Shape:
    """A cylinder about x with rounded edges."""
    if not min(radius_mm, length_mm / 2) >= rounding_mm >= 0:
        raise ValueError(
            f"a cylinder of radius {radius_mm} and length {length_mm} mm has no edges of radius {rounding_mm} mm"
        )

    def sdf(p: F64) -> F64:
        side = np.hypot(p[:, 1], p[:, 2]) - np.float32(radius_mm - rounding_mm)
        end = np.abs(p[:, 0]) - np.float32(length_mm / 2 - rounding_mm)
        outside = np.hypot(np.maximum(side, 0), np.maximum(end, 0))
        return np.asarray(outside + np.minimum(np.maximum(side, end), 0) - np.float32(rounding_mm))

    return Shape("cylinder", sdf)


def sphere(radius_mm: float) -> Shape:
    """A ball with its centre at the origin."""
    return Shape("sphere", lambda p: np.asarray(np.linalg.norm(p, axis=1) - np.float32(radius_mm)))


def lathed(name: str, outline_mm: Sequence[tuple[float, float]], rounding_mm: float = 2.0) -> Shape:
    """A solid of revolution about x from the corners (x, distance from x) of its outline; the rounding of convex edges
    is added around it and removes nothing.
    """
    upper = list(outline_mm)
    profile = polygon([*upper, *((x, -rho) for x, rho in reversed(upper))])

    def sdf(p: F64) -> F64:
        return (profile(p[:, 0], np.hypot(p[:, 1], p[:, 2])) - rounding_mm).astype(p.dtype)

    return Shape(name, sdf)
