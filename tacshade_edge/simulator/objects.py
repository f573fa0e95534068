"""Objects to press: signed distance functions in mm, vectorised.

Every shape stands on its own origin: its lowest point has z = 0 there, and it extends towards +z, away from the
sensor. Outside, distances are exact or too small, never too large, so that a ray may step by them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.types import F64

Sdf = Callable[[F64], F64]
"""A function from points (N, 3) in mm to signed distances (N,) in mm, negative inside."""

_HEIGHT_MM = 30.0  # of extruded shapes: higher than any press is deep
_ROUNDING_MM = 0.2  # of their edges, as printed


@dataclass(frozen=True, slots=True)
class Shape:
    """A solid in its own frame."""

    name: str
    sdf: Sdf


def ball(radius_mm: float = 6.0) -> Shape:
    """A ball; its centre is (0, 0, radius)."""
    if not (math.isfinite(radius_mm) and radius_mm > 0):
        raise ValueError(f"radius_mm is {radius_mm}, expected a positive number")

    def sdf(p: F64) -> F64:
        return _length(p[:, 0], p[:, 1], p[:, 2] - radius_mm) - radius_mm

    return Shape("ball", sdf)


def _length(*components: F64) -> F64:
    total = components[0] * components[0]
    for c in components[1:]:
        total = total + c * c
    return np.asarray(np.sqrt(total))


def _extrude(name: str, outline: Callable[[F64, F64], F64]) -> Shape:
    """Stand a 2-D outline (a signed distance in the x, y plane) on z = 0, with rounded edges."""

    def sdf(p: F64) -> F64:
        side = outline(p[:, 0], p[:, 1]) + _ROUNDING_MM
        cap = np.abs(p[:, 2] - _HEIGHT_MM / 2) - (_HEIGHT_MM / 2 - _ROUNDING_MM)
        outside = _length(np.maximum(side, 0), np.maximum(cap, 0))
        return np.asarray(np.minimum(np.maximum(side, cap), 0) + outside - _ROUNDING_MM)

    return Shape(name, sdf)


def _rectangle(half_x: float, half_y: float) -> Callable[[F64, F64], F64]:
    def outline(x: F64, y: F64) -> F64:
        dx, dy = np.abs(x) - half_x, np.abs(y) - half_y
        return np.asarray(_length(np.maximum(dx, 0), np.maximum(dy, 0)) + np.minimum(np.maximum(dx, dy), 0))

    return outline


def _disc(radius: float) -> Callable[[F64, F64], F64]:
    return lambda x, y: _length(x, y) - radius


def _moon(outer: float, inner: float, offset: float) -> Callable[[F64, F64], F64]:
    """A disc minus another disc with its centre at `offset` along x; centred on the middle of the crescent."""
    a = (outer**2 - inner**2 + offset**2) / (2 * offset)
    b = math.sqrt(max(outer**2 - a**2, 0.0))
    middle = 0.5 * (-outer + a)

    def outline(x: F64, y: F64) -> F64:
        x, y = x + middle, np.abs(y)
        horn = offset * (x * b - y * a) > offset**2 * np.maximum(b - y, 0)
        body = np.maximum(_length(x, y) - outer, inner - _length(x - offset, y))
        return np.where(horn, _length(x - a, y - b), body)

    return outline


def polygon(vertices: Sequence[tuple[float, float]]) -> Callable[[F64, F64], F64]:
    """The exact signed distance to a simple polygon."""
    v = np.asarray(vertices, float)

    def outline(x: F64, y: F64) -> F64:
        nearest = np.full(x.shape, np.inf)
        inside = np.zeros(x.shape, bool)
        for (ax, ay), (bx, by) in zip(v, np.roll(v, -1, axis=0), strict=True):
            ex, ey, wx, wy = bx - ax, by - ay, x - ax, y - ay
            s = np.clip((wx * ex + wy * ey) / (ex * ex + ey * ey), 0, 1)
            nearest = np.minimum(nearest, (wx - s * ex) ** 2 + (wy - s * ey) ** 2)
            if ey != 0:
                inside ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) * (ex / ey))
        return np.asarray(np.where(inside, -1.0, 1.0) * np.sqrt(nearest))

    return outline


def _revolve(name: str, profile: Callable[[F64, F64], F64]) -> Shape:
    """Turn a profile in (distance from the axis, z) about the z axis."""
    return Shape(name, lambda p: profile(_length(p[:, 0], p[:, 1]), p[:, 2]))


def _union(name: str, *parts: tuple[Shape, float, float]) -> Shape:
    """Join shapes, each moved by (x, y)."""

    def sdf(p: F64) -> F64:
        return np.asarray(np.min([s.sdf(p - np.array((x, y, 0.0), p.dtype)) for s, x, y in parts], axis=0))

    return Shape(name, sdf)


def _cross() -> Shape:
    one, other = _rectangle(7.0, 1.5), _rectangle(1.5, 7.0)
    return _extrude("cross", lambda x, y: np.minimum(one(x, y), other(x, y)))


def _ring() -> Shape:
    return Shape("ring", lambda p: _length(_length(p[:, 0], p[:, 1]) - 5.5, p[:, 2] - 1.6) - 1.6)


def _bar() -> Shape:
    def sdf(p: F64) -> F64:
        return _length(p[:, 0] - np.clip(p[:, 0], -7.0, 7.0), p[:, 1], p[:, 2] - 2.0) - 2.0

    return Shape("bar", sdf)


def _edge() -> Shape:
    """A wedge of 90° with a slightly rounded edge along x that faces the skin."""
    wedge = polygon(((0.0, 0.0), (8.0, 8.0), (8.0, 20.0), (-8.0, 20.0), (-8.0, 8.0)))
    rounding = 0.3

    def sdf(p: F64) -> F64:
        outline = wedge(p[:, 1], p[:, 2] - rounding)
        end = np.abs(p[:, 0]) - 9.0
        outside = _length(np.maximum(outline, 0), np.maximum(end, 0))
        return np.asarray(np.minimum(np.maximum(outline, end), 0) + outside - rounding)

    return Shape("edge", sdf)


def bars(width_mm: float, gap_mm: float, length_mm: float = 12.0) -> Shape:
    """Two flat bars along y of the same width, side by side along x; a gap of 0 makes them one."""
    one = _rectangle(width_mm / 2, length_mm / 2)
    middle = (gap_mm + width_mm) / 2
    return _extrude("bars", lambda x, y: one(np.abs(x) - middle, y))


def ridge(width_mm: float, length_mm: float = 12.0) -> Shape:
    """One flat bar along y, at least 0.4 mm wide because its edges are rounded."""
    return _extrude("ridge", _rectangle(width_mm / 2, length_mm / 2))


def _cone() -> Shape:
    profile = polygon(((-7.0, 9.0), (0.0, 0.0), (7.0, 9.0), (7.0, 20.0), (-7.0, 20.0)))
    return _revolve("cone", lambda rho, z: profile(rho, z - 0.8) - 0.8)


OBJECTS: dict[str, Callable[[], Shape]] = {
    # The paper's five.
    "cube": lambda: _extrude("cube", _rectangle(5.0, 5.0)),
    "small_crescent": lambda: _extrude("small_crescent", _moon(5.0, 4.0, 3.0)),
    "ball": ball,
    "large_crescent": lambda: _extrude("large_crescent", _moon(9.0, 7.5, 5.0)),
    "cylinder": lambda: _extrude("cylinder", _disc(5.0)),
    # Others.
    "bar": _bar,
    "cone": _cone,
    "cross": _cross,
    "edge": _edge,
    "plate": lambda: _extrude("plate", _disc(25.0)),
    "prism": lambda: _extrude("prism", polygon(((6.0, 0.0), (-3.0, 5.2), (-3.0, -5.2)))),
    "ring": _ring,
    "two_balls": lambda: _union("two_balls", (ball(3.5), -5.0, 0.0), (ball(3.5), 5.0, 0.0)),
}
"""Name to factory; the first five are the paper's."""

PAPER_OBJECTS = ("cube", "small_crescent", "ball", "large_crescent", "cylinder")
