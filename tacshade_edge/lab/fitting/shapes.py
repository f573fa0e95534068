"""Random objects for training: none of `lab.simulator.press`,
but many objects like them and many others.

Outside an object, distances are exact or too small but never too large, as the simulator requires.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tacshade_edge.lab.simulator.press import Sdf, Shape
from tacshade_edge.types import F64

Outline = Callable[[F64, F64], F64]
Rng = np.random.Generator

_HEIGHT_MM = 30.0


def random_shape(rng: Rng) -> Shape:
    """Draw a solid; its lowest point has z = 0."""
    kind = rng.choice(len(_KINDS), p=_WEIGHTS)
    return _stand(_KINDS[kind](rng))


def _norm(*components: F64) -> F64:
    total = components[0] * components[0]
    for c in components[1:]:
        total = total + c * c
    return np.asarray(np.sqrt(total))


def _away(rng: Rng, low: float, high: float, *taken: float) -> float:
    """Draw a size that is not within 5 % of a test object's (`taken`)."""
    while True:
        value = float(rng.uniform(low, high))
        # Networks are judged on those objects: a size of theirs in training would be a leak.
        if all(abs(value / t - 1) > 0.05 for t in taken):
            return value


def _rotation(rng: Rng, tilt_deg: float) -> F64:
    """Draw a turn by any angle about z, then a tilt by up to `tilt_deg` in any direction."""
    turn, lean = rng.uniform(0, 2 * math.pi, 2)
    tilt = math.radians(tilt_deg) * math.sqrt(rng.uniform())

    def about_z(a: float) -> F64:
        return np.array(((math.cos(a), -math.sin(a), 0), (math.sin(a), math.cos(a), 0), (0, 0, 1)))

    about_x = np.array(
        ((1, 0, 0), (0, math.cos(tilt), -math.sin(tilt)), (0, math.sin(tilt), math.cos(tilt)))
    )
    return np.asarray(about_z(lean) @ about_x @ about_z(turn))


def _turned(sdf: Sdf, rotation: F64) -> Sdf:
    return lambda p: sdf(p @ rotation)


def _stand(sdf: Sdf) -> Shape:
    """Move a solid along z until its lowest point has z = 0."""
    axis = np.linspace(-16, 16, 49)
    x, y = (v.ravel() for v in np.meshgrid(axis, axis))
    z = np.full(x.shape, -40.0)
    for _ in range(48):
        # Only columns that may still contain the lowest point.
        low = z < float(z.min()) + 6.0
        d = sdf(np.stack((x[low], y[low], z[low]), axis=1))
        z[low] += np.maximum(d, 0)
        if float(d.max()) < 1e-3:
            break
        z[low & (z > 40)] = 40.0
    lowest = float(z.min())
    return Shape("random", lambda p: sdf(p + np.array((0.0, 0.0, lowest), p.dtype)))


# Outlines in the plane.


def _disc(radius: float, x0: float = 0.0, y0: float = 0.0) -> Outline:
    return lambda x, y: _norm(x - x0, y - y0) - radius


def _rectangle(
    half_x: float, half_y: float, x0: float = 0.0, y0: float = 0.0, turn: float = 0.0
) -> Outline:
    c, s = math.cos(turn), math.sin(turn)

    def outline(x: F64, y: F64) -> F64:
        x, y = x - x0, y - y0
        dx, dy = np.abs(c * x + s * y) - half_x, np.abs(c * y - s * x) - half_y
        return np.asarray(
            _norm(np.maximum(dx, 0), np.maximum(dy, 0)) + np.minimum(np.maximum(dx, dy), 0)
        )

    return outline


def _ellipse(a: float, b: float) -> Outline:
    # Too small by up to the ratio of the axes, and never too large.
    return lambda x, y: (_norm(x / a, y / b) - 1) * min(a, b)


def _convex(rng: Rng, corners: int, radius: float) -> Outline:
    """Intersect half planes at roughly even angles."""
    angles = (np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) * (2 * math.pi / corners)
    reach = (
        radius * rng.uniform(0.6, 1.0, corners) if rng.random() < 0.6 else np.full(corners, radius)
    )
    return lambda x, y: np.max(
        [math.cos(a) * x + math.sin(a) * y - w for a, w in zip(angles, reach, strict=True)], axis=0
    )


def _minus(one: Outline, other: Outline) -> Outline:
    return lambda x, y: np.maximum(one(x, y), -other(x, y))


def _plus(*parts: Outline) -> Outline:
    return lambda x, y: np.min([part(x, y) for part in parts], axis=0)


def _ridges(width: float, period: float, length: float, count: int) -> Outline:
    def outline(x: F64, y: F64) -> F64:
        k = np.clip(np.rint(x / period), -count, count)
        return _rectangle(width / 2, length)(x - k * period, y)

    return outline


def _random_outline(rng: Rng) -> Outline:
    def draw(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    match int(rng.integers(0, 11)):
        case 0:
            return _disc(_away(rng, 1.5, 13.0, 5.0))
        case 1:
            return _ellipse(draw(1.5, 12.0), draw(1.5, 8.0))
        case 2:
            return _rectangle(_away(rng, 0.8, 11.0, 5.0), _away(rng, 0.8, 7.0, 5.0))
        case 3 | 4:
            return _convex(rng, int(rng.integers(3, 9)), draw(2.0, 8.0))
        case 5 | 6:  # crescents and bites
            outer = _away(rng, 3.5, 12.0, 5.0, 9.0)
            part = draw(0.45, 0.95)
            return _minus(_disc(outer), _disc(part * outer, draw(1 - part, 1.1) * outer))
        case 7:  # rings and open rings
            outer, width = draw(3.0, 11.0), draw(1.0, 3.0)
            ring = _minus(_disc(outer), _disc(max(outer - width, 0.5)))
            if rng.random() < 0.5:
                return ring
            return _minus(ring, _rectangle(outer, draw(0.8, outer), outer))
        case 8:  # crosses, L, T
            arms = [
                _rectangle(
                    draw(3.0, 8.5), draw(0.8, 2.5), draw(-4, 4), draw(-4, 4), draw(0, 2 * math.pi)
                )
                for _ in range(int(rng.integers(2, 4)))
            ]
            return _plus(*arms)
        case 9:
            width = draw(0.8, 3.5)
            return _ridges(width, width + draw(0.8, 4.0), draw(3.0, 10.0), int(rng.integers(0, 4)))
        case _:  # a body with holes
            body = (
                _disc(draw(4.0, 11.0))
                if rng.random() < 0.5
                else _rectangle(draw(3.5, 9.0), draw(3.5, 9.0))
            )
            for _ in range(int(rng.integers(1, 4))):
                body = _minus(body, _disc(draw(0.8, 3.5), draw(-6, 6), draw(-6, 6)))
            return body


# Solids.


def _extruded(rng: Rng) -> Sdf:
    outline = _random_outline(rng)
    rounding = float(rng.choice((rng.uniform(0.1, 0.35), rng.uniform(0.1, 1.2))))
    # Drafted walls, as of what is cast or moulded.
    wall = math.tan(math.radians(rng.uniform(0, 35))) if rng.random() < 0.25 else 0.0
    slope = 1 / math.sqrt(1 + wall * wall)

    def sdf(p: F64) -> F64:
        side = (outline(p[:, 0], p[:, 1]) - wall * p[:, 2]) * slope + rounding
        cap = np.abs(p[:, 2] - _HEIGHT_MM / 2) - (_HEIGHT_MM / 2 - rounding)
        if wall:
            return np.asarray(np.maximum(side, cap) - rounding)
        outside = _norm(np.maximum(side, 0), np.maximum(cap, 0))
        return np.asarray(np.minimum(np.maximum(side, cap), 0) + outside - rounding)

    # Half of them upright, as objects are pressed on purpose; people hold the others askew.
    tilt = 0.0 if rng.random() < 0.5 else 25.0
    return _turned(sdf, _rotation(rng, tilt))


def _ball(rng: Rng) -> Sdf:
    radius = _away(rng, 1.5, 14.0, 3.5, 6.0)
    return lambda p: _norm(p[:, 0], p[:, 1], p[:, 2]) - radius


def _ellipsoid(rng: Rng) -> Sdf:
    axes = rng.uniform(2.0, 11.0, 3)
    least = float(axes.min())
    return _turned(lambda p: (_norm(*(p / axes).T) - 1) * least, _rotation(rng, 90.0))


def _capsule(rng: Rng) -> Sdf:
    half, radius = float(rng.uniform(2.0, 12.0)), _away(rng, 0.8, 5.0, 2.0)
    return _turned(
        lambda p: _norm(p[:, 0] - np.clip(p[:, 0], -half, half), p[:, 1], p[:, 2]) - radius,
        _rotation(rng, 20.0),
    )


def _torus(rng: Rng) -> Sdf:
    ring, tube = _away(rng, 2.5, 9.0, 5.5), float(rng.uniform(0.8, 2.6))
    return _turned(
        lambda p: _norm(_norm(p[:, 0], p[:, 1]) - ring, p[:, 2]) - tube, _rotation(rng, 20.0)
    )


def _box(rng: Rng) -> Sdf:
    """Draw a box in any orientation, so that a face, an edge or a corner points down."""
    half, rounding = rng.uniform(2.0, 10.0, 3), float(rng.uniform(0.1, 1.0))

    def sdf(p: F64) -> F64:
        q = np.abs(p) - (half - rounding)
        outside = _norm(*np.maximum(q, 0).T)
        return np.asarray(np.minimum(q.max(axis=1), 0) + outside - rounding)

    return _turned(sdf, _rotation(rng, 90.0))


def _cone(rng: Rng) -> Sdf:
    """Draw a cone or a pyramid with a rounded point, which points down."""
    angle, rounding = math.radians(rng.uniform(35, 70)), float(rng.uniform(0.2, 2.0))
    sides = int(rng.choice((0, 2, 3, 4, 5)))
    s, c = math.sin(angle), math.cos(angle)

    def sdf(p: F64) -> F64:
        if sides == 0:
            rho = _norm(p[:, 0], p[:, 1])
        else:
            turn = 2 * math.pi / sides
            rho = np.max(
                [math.cos(k * turn) * p[:, 0] + math.sin(k * turn) * p[:, 1] for k in range(sides)],
                axis=0,
            )
            if sides == 2:
                rho = np.maximum(rho, (np.abs(p[:, 1]) - 9) / max(c, 0.1))
        # The half angle is measured from the axis; points with c·rho < s·z are inside.
        return np.asarray(np.maximum(c * rho - s * p[:, 2], p[:, 2] - 20) - rounding)

    return _turned(sdf, _rotation(rng, 20.0))


def _bumpy(rng: Rng) -> Sdf:
    """Draw a round plate with bumps and dents."""
    radius = float(rng.uniform(4.0, 14.0))
    n = int(rng.integers(1, 6))
    centre, width, top = (
        rng.uniform(-7, 7, (n, 2)),
        rng.uniform(1.0, 4.0, n),
        rng.uniform(-2.5, 2.5, n),
    )
    # The greatest slopes of the Gaussians.
    steep = float(np.sum(np.abs(top) / width)) * 0.61
    # Heights above a slope are longer than the distance to it: divided by its length, they are no
    # longer too large.
    slope = 1 / math.sqrt(1 + min(steep, 4.0) ** 2)

    def sdf(p: F64) -> F64:
        z = p[:, 2]
        for (x0, y0), w, t in zip(centre, width, top, strict=True):
            z = z + t * np.exp(-((p[:, 0] - x0) ** 2 + (p[:, 1] - y0) ** 2) / (2 * w * w))
        return np.asarray(
            np.maximum(np.maximum(-z, p[:, 2] - 25) * slope, _norm(p[:, 0], p[:, 1]) - radius)
        )

    return _turned(sdf, _rotation(rng, 10.0))


_KINDS: tuple[Callable[[Rng], Sdf], ...] = (
    _extruded,
    _ball,
    _ellipsoid,
    _capsule,
    _torus,
    _box,
    _cone,
    _bumpy,
)
# Extruded outlines have the most variety, and are nearly half of what is drawn.
_WEIGHTS = (0.46, 0.10, 0.06, 0.09, 0.06, 0.09, 0.07, 0.07)
