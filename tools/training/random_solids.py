"""Random solids, pressed to learn what differs between objects and what between touches of one."""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.lab.simulator.press import Sdf, Shape, polygon
from tacshade_edge.types import F64
from tools.testbed.simulator.household import (
    Outline,
    disc,
    ellipsoid,
    joined,
    lying,
    rectangle,
    regular,
    standing,
    turned,
    union,
    without,
)

KINDS = 12


def random_solid(number: int) -> Shape:
    """Draw a solid; the same number gives the same one, and kinds take turns."""
    rng = np.random.default_rng((number, 61))
    return Shape(f"solid_{number}", _MAKERS[number % KINDS](rng))


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _corners(rng: np.random.Generator) -> Outline:
    """A polygon of 3 to 9 corners about the origin, more or less regular, more or less long."""
    count = int(rng.integers(3, 10))
    size, long, uneven = _log(rng, 3.0, 11.0), rng.uniform(0.35, 1.0), rng.choice((0.0, 0.3))
    angles = 2 * math.pi * (np.arange(count) + rng.uniform(-uneven, uneven, count)) / count
    radii = size * (1 + rng.uniform(-uneven, uneven, count))
    return polygon(
        [(r * math.cos(a), long * r * math.sin(a)) for r, a in zip(radii, angles, strict=True)]
    )


def _plain(rng: np.random.Generator) -> Sdf:
    return standing(_corners(rng), edge_mm=rng.choice((0.2, 0.2, 1.0)))


def _round(rng: np.random.Generator) -> Sdf:
    return standing(disc(_log(rng, 1.5, 11.0)), edge_mm=rng.choice((0.2, 0.2, 1.2)))


def _with_hole(rng: np.random.Generator) -> Sdf:
    size = _log(rng, 3.5, 11.0)
    whole = regular(int(rng.integers(3, 9)), 2 * size) if rng.random() < 0.5 else disc(size)
    hole = size * rng.uniform(0.3, 0.85)
    room = size - hole - 0.5
    return standing(without(whole, disc(hole, rng.uniform(0, max(room, 0)))))


def _moon(rng: np.random.Generator) -> Sdf:
    size = _log(rng, 4.0, 10.0)
    return standing(
        without(disc(size), disc(size * rng.uniform(0.6, 0.95), size * rng.uniform(0.3, 0.8)))
    )


def _egg(rng: np.random.Generator) -> Sdf:
    x, y, z = sorted((_log(rng, 2.5, 16.0) for _ in range(3)), reverse=True)
    return ellipsoid(x, y, z) if rng.random() < 0.6 else ellipsoid(x, x, min(z, y))


def _rod(rng: np.random.Generator) -> Sdf:
    radius = _log(rng, 0.8, 6.0)
    length = _log(rng, 5.0, 40.0)
    if rng.random() < 0.5:
        return lying(disc(radius, 0.0, radius), length, edge_mm=min(0.2, radius / 4))
    many = int(rng.integers(4, 8))
    return lying(lambda y, z: regular(many, 2 * radius)(y, z - radius), length)


def _tip(rng: np.random.Generator) -> Sdf:
    slope, rounding = rng.uniform(0.3, 2.2), rng.uniform(0.2, 2.5)
    wide = _log(rng, 3.0, 12.0)
    high = wide / slope
    cone = polygon(((-wide, high), (0.0, 0.0), (wide, high), (wide, high + 20), (-wide, high + 20)))
    return turned(lambda rho, z: cone(rho, z - rounding) - rounding)


def _several(rng: np.random.Generator) -> Sdf:
    parts: list[Sdf] = []
    for k in range(int(rng.integers(2, 5))):
        x, y = rng.uniform(-6, 6, 2)
        size = _log(rng, 1.2, 3.5)
        low = 0.0 if k == 0 else rng.choice((0.0, 0.0, 0.8, 1.6))
        if rng.random() < 0.4:
            parts.append(_ball_at(x, y, low + size, size))
        else:
            parts.append(standing(disc(size, x, y), low_mm=low))
    return union(*parts)


def _ball_at(x: float, y: float, z: float, radius: float) -> Sdf:
    middle = np.array((x, y, z))
    return lambda p: np.asarray(np.linalg.norm(p - middle, axis=1) - radius)


def _bars(rng: np.random.Generator) -> Sdf:
    width, gap, count = rng.uniform(0.6, 3.0), rng.uniform(0.8, 4.0), int(rng.integers(1, 6))
    one = rectangle(width, _log(rng, 6.0, 20.0))
    places = (np.arange(count) - (count - 1) / 2) * (width + gap)
    return standing(joined(*(_moved(one, x) for x in places)))


def _moved(outline: Outline, x_mm: float) -> Outline:
    return lambda x, y: outline(x - x_mm, y)


def _torus(rng: np.random.Generator) -> Sdf:
    thin = _log(rng, 0.6, 2.5)
    wide = thin + _log(rng, 1.5, 7.0)

    def sdf(p: F64) -> F64:
        return np.asarray(np.hypot(np.hypot(p[:, 0], p[:, 1]) - wide, p[:, 2] - thin) - thin)

    return sdf


def _roof(rng: np.random.Generator) -> Sdf:
    slope, rounding = rng.uniform(0.4, 2.0), rng.uniform(0.2, 1.0)
    roof = polygon(((-8.0, 8 * slope), (0.0, 0.0), (8.0, 8 * slope), (8.0, 40.0), (-8.0, 40.0)))
    half = _log(rng, 2.5, 15.0)

    def sdf(p: F64) -> F64:
        ends = np.abs(p[:, 0]) - half
        return np.asarray(np.maximum(roof(p[:, 1], p[:, 2] - rounding), ends) - rounding)

    return sdf


def _stepped(rng: np.random.Generator) -> Sdf:
    upper = disc(_log(rng, 4.0, 9.0)) if rng.random() < 0.5 else _corners(rng)
    lower = (
        disc(_log(rng, 1.0, 3.5)) if rng.random() < 0.5 else rectangle(*rng.uniform(1.5, 6.0, 2))
    )
    return union(standing(lower), standing(upper, low_mm=rng.uniform(0.5, 2.0)))


_MAKERS = (
    _plain,
    _round,
    _with_hole,
    _moon,
    _egg,
    _rod,
    _tip,
    _several,
    _bars,
    _torus,
    _roof,
    _stepped,
)
