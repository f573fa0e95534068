"""Twenty household objects as solids, in life size, each with the side down that a hand would press
on the skin.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from tacshade_edge.lab.simulator.press import Sdf, Shape, ball, polygon
from tacshade_edge.types import F64

Outline = Callable[[F64, F64], F64]
"""A function from x and y (N,) in mm to signed distances (N,) in mm, negative inside."""

_FAR_MM = 30.0  # height of a solid that ends beyond any press
_EDGE_MM = 0.2  # radius of worn edges


def disc(radius_mm: float, x_mm: float = 0.0, y_mm: float = 0.0) -> Outline:
    """A disc about (x, y)."""
    return lambda x, y: np.hypot(x - x_mm, y - y_mm) - radius_mm


def rectangle(length_mm: float, width_mm: float) -> Outline:
    """A rectangle about the origin, its length along x."""
    return lambda x, y: _both(np.abs(x) - length_mm / 2, np.abs(y) - width_mm / 2)


def regular(corners: int, across_mm: float) -> Outline:
    """A regular polygon with a flat side towards -y and this distance from the middle to each side,
    twice.
    """
    radius_mm = across_mm / 2 / math.cos(math.pi / corners)
    angles = (2 * np.arange(corners) + 1) * math.pi / corners - math.pi / 2
    return polygon([(radius_mm * math.cos(a), radius_mm * math.sin(a)) for a in angles])


def without(whole: Outline, *holes: Outline) -> Outline:
    """An outline less the parts inside others."""
    return lambda x, y: np.maximum(whole(x, y), -np.min([hole(x, y) for hole in holes], axis=0))


def joined(*parts: Outline) -> Outline:
    """All that lies in one of the outlines."""
    return lambda x, y: np.min([part(x, y) for part in parts], axis=0)


def standing(outline: Outline, low_mm: float = 0.0, edge_mm: float = _EDGE_MM) -> Sdf:
    """The solid over an outline from a height on, with rounded edges."""
    middle, half = (low_mm + _FAR_MM) / 2, (_FAR_MM - low_mm) / 2

    def sdf(p: F64) -> F64:
        side, ends = outline(p[:, 0], p[:, 1]) + edge_mm, np.abs(p[:, 2] - middle) - half + edge_mm
        return _both(side, ends) - edge_mm

    return sdf


def lying(profile: Outline, length_mm: float, edge_mm: float = _EDGE_MM) -> Sdf:
    """The solid of a profile over y and z, along x."""

    def sdf(p: F64) -> F64:
        side = profile(p[:, 1], p[:, 2]) + edge_mm
        return _both(side, np.abs(p[:, 0]) - length_mm / 2 + edge_mm) - edge_mm

    return sdf


def turned(profile: Outline) -> Sdf:
    """The solid of revolution of a profile over the distance from the z axis and z."""
    return lambda p: profile(np.hypot(p[:, 0], p[:, 1]), p[:, 2])


def union(*solids: Sdf) -> Sdf:
    """All that lies in one of the solids."""
    return lambda p: np.min([solid(p) for solid in solids], axis=0)


def ellipsoid(x_mm: float, y_mm: float, z_mm: float) -> Sdf:
    """An ellipsoid with these half axes that rests on z = 0; distances are bounds from below."""
    axes = np.array((x_mm, y_mm, z_mm))

    def sdf(p: F64) -> F64:
        inside = (p - (0.0, 0.0, z_mm)) / axes
        return np.asarray((np.linalg.norm(inside, axis=1) - 1) * axes.min())

    return sdf


def _both(one: F64, other: F64) -> F64:
    outside = np.hypot(np.maximum(one, 0), np.maximum(other, 0))
    return np.asarray(np.minimum(np.maximum(one, other), 0) + outside)


def _teeth(tops_mm: Sequence[float], pitch_mm: float) -> Outline:
    """The toothed edge of a key over x and z: a point down at each of these heights, notches of 45°
    between them.
    """
    corners, left = [], -pitch_mm * len(tops_mm) / 2
    for k, top in enumerate(tops_mm):
        x = left + k * pitch_mm
        corners += [(x, 2.0), (x + 0.35 * pitch_mm, top), (x + 0.65 * pitch_mm, top)]
    right = -left
    return polygon([*corners, (right, 2.0), (right, _FAR_MM), (left, _FAR_MM)])


def _key_teeth() -> Sdf:
    profile = _teeth((0.0, 0.6, 0.0, 1.0, 0.3), 3.4)
    return lambda p: _both(profile(p[:, 0], p[:, 2]), np.abs(p[:, 1]) - 1.1)


def _brick() -> Sdf:
    studs = joined(*(disc(2.4, x, y) for x in (-4.0, 4.0) for y in (-4.0, 4.0)))
    return union(standing(studs), standing(rectangle(15.8, 15.8), low_mm=1.8))


def _pen_tip() -> Sdf:
    tip = polygon(((-5.0, 10.0), (0.0, 0.0), (5.0, 10.0), (5.0, 30.0), (-5.0, 30.0)))
    rounding = 0.5
    return turned(lambda rho, z: tip(rho, z - rounding) - rounding)


def _solids() -> dict[str, Sdf]:
    coin = disc(11.6, 0.0, 11.6)
    frame = without(rectangle(12.0, 4.5), rectangle(10.2, 2.7))
    comb = joined(*(_bar(x) for x in (-3.9, -1.3, 1.3, 3.9)))
    return {
        "battery": union(standing(disc(1.9)), standing(disc(5.2), low_mm=1.2)),
        "bead": ball(3.0).sdf,
        "bottle_cap": standing(without(disc(7.0), disc(5.8))),
        "brick": _brick(),
        "coin_on_edge": lambda p: lying(coin, 2.3)(p),
        "coin_on_face": standing(disc(8.1)),
        "comb": standing(comb),
        "die": standing(regular(4, 12.0), edge_mm=1.0),
        "key_bow": standing(without(disc(10.0), disc(3.0, 0.0, 5.0))),
        "key_teeth": _key_teeth(),
        "marble": ball(8.0).sdf,
        "nail": lying(disc(1.5, 0.0, 1.5), 30.0),
        "nut_m4": standing(without(regular(6, 7.0), disc(1.7))),
        "nut_m8": standing(without(regular(6, 13.0), disc(3.4))),
        "pen_barrel": lying(disc(4.5, 0.0, 4.5), 40.0),
        "pen_tip": _pen_tip(),
        "pencil": lying(lambda y, z: regular(6, 7.0)(y, z - 3.5), 40.0),
        "spoon": ellipsoid(14.0, 9.0, 6.0),
        "usb_plug": standing(frame),
        "washer_m10": standing(without(disc(10.0), disc(5.3))),
    }


def _bar(x_mm: float) -> Outline:
    one = rectangle(0.9, 14.0)
    return lambda x, y: one(x - x_mm, y)


HOUSEHOLD: dict[str, Shape] = {name: Shape(name, sdf) for name, sdf in _solids().items()}
"""Name to solid."""
