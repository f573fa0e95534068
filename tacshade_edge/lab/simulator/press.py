"""Objects to press, as signed distance functions in mm, and a press:
the convention of every press in this package.

Every shape stands on its own origin: its lowest point has z = 0 there, and it extends towards +z,
away from the sensor. Outside, distances are exact or too small, never too large, so that a ray may
step by them.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from tacshade_edge.types import F64

Sdf = Callable[[F64], F64]
"""A function from points (N, 3) in mm to signed distances (N,) in mm, negative inside."""

# Of extruded shapes: higher than any press is deep.
_HEIGHT_MM = 30.0
# Of their edges, as printed; a sharp edge would have an infinite pressure.
_ROUNDING_MM = 0.2


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


def _both(one: F64, other: F64) -> F64:
    """Signed distance to what is in both of two solids whose surfaces meet at right angles."""
    outside = _length(np.maximum(one, 0), np.maximum(other, 0))
    return np.asarray(np.minimum(np.maximum(one, other), 0) + outside)


def _extrude(name: str, outline: Callable[[F64, F64], F64]) -> Shape:
    """Stand a 2-D outline (a signed distance in the x, y plane) on z = 0, with rounded edges."""

    def sdf(p: F64) -> F64:
        side = outline(p[:, 0], p[:, 1]) + _ROUNDING_MM
        return (
            _both(side, np.abs(p[:, 2] - _HEIGHT_MM / 2) - (_HEIGHT_MM / 2 - _ROUNDING_MM))
            - _ROUNDING_MM
        )

    return Shape(name, sdf)


def _rectangle(half_x: float, half_y: float) -> Callable[[F64, F64], F64]:
    return lambda x, y: _both(np.abs(x) - half_x, np.abs(y) - half_y)


def _disc(radius: float) -> Callable[[F64, F64], F64]:
    return lambda x, y: _length(x, y) - radius


def _moon(outer: float, inner: float, offset: float) -> Callable[[F64, F64], F64]:
    """A disc minus another disc with its centre at `offset` along x;
    centred on the middle of the crescent.
    """
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


def _union(name: str, *parts: tuple[Shape, float, float]) -> Shape:
    """Join shapes, each moved by (x, y)."""

    def sdf(p: F64) -> F64:
        return np.asarray(
            np.min([s.sdf(p - np.array((x, y, 0.0), p.dtype)) for s, x, y in parts], axis=0)
        )

    return Shape(name, sdf)


def _cross() -> Shape:
    one, other = _rectangle(7.0, 1.5), _rectangle(1.5, 7.0)
    return _extrude("cross", lambda x, y: np.minimum(one(x, y), other(x, y)))


def _ring() -> Shape:
    return Shape("ring", lambda p: _length(_length(p[:, 0], p[:, 1]) - 5.5, p[:, 2] - 1.6) - 1.6)


def _bar() -> Shape:
    return Shape(
        "bar",
        lambda p: _length(p[:, 0] - np.clip(p[:, 0], -7.0, 7.0), p[:, 1], p[:, 2] - 2.0) - 2.0,
    )


def _edge() -> Shape:
    """A wedge of 90° with a slightly rounded edge along x that faces the skin."""
    wedge = polygon(((0.0, 0.0), (8.0, 8.0), (8.0, 20.0), (-8.0, 20.0), (-8.0, 8.0)))
    rounding = 0.3

    def sdf(p: F64) -> F64:
        return _both(wedge(p[:, 1], p[:, 2] - rounding), np.abs(p[:, 0]) - 9.0) - rounding

    return Shape("edge", sdf)


def bars(width_mm: float, gap_mm: float) -> Shape:
    """Two flat bars of 12 mm along y, of the same width, side by side along x;
    a gap of 0 makes them one.
    """
    one = _rectangle(width_mm / 2, 6.0)
    middle = (gap_mm + width_mm) / 2
    return _extrude("bars", lambda x, y: one(np.abs(x) - middle, y))


def ridge(width_mm: float, length_mm: float = 12.0) -> Shape:
    """One flat bar along y, at least 0.4 mm wide because its edges are rounded."""
    return _extrude("ridge", _rectangle(width_mm / 2, length_mm / 2))


def _cone() -> Shape:
    profile = polygon(((-7.0, 9.0), (0.0, 0.0), (7.0, 9.0), (7.0, 20.0), (-7.0, 20.0)))
    return Shape("cone", lambda p: profile(_length(p[:, 0], p[:, 1]), p[:, 2] - 0.8) - 0.8)


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


@dataclass(frozen=True, slots=True)
class Press:
    """An indenter that moved along -z and then along the skin.

    x, y is where the object's origin is after the drag. `depth_mm` is z of the undeformed skin
    there minus z of the lowest point, not the travel from first touch. The shape is enlarged by
    `scale` about its lowest point, turned about its z axis from x towards y, and tilted about the
    sensor's x, then y axis. Drag and twist (about z through (x, y)) say how far it moved after it
    touched.
    """

    shape: Shape
    x_mm: float = 0.0
    y_mm: float = 0.0
    depth_mm: float = 3.0
    rotation_deg: float = 0.0
    scale: float = 1.0
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0
    drag_x_mm: float = 0.0
    drag_y_mm: float = 0.0
    twist_deg: float = 0.0

    def __post_init__(self) -> None:
        """Raise ValueError for values that are not finite, or a scale of 0 or less."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, int | float) and not math.isfinite(value):
                raise ValueError(f"{field.name} is {value}, expected a finite number")
        if self.scale <= 0:
            raise ValueError(f"scale is {self.scale}, expected a positive number")

    def lowest_z_mm(self, skin_radius_mm: float) -> float:
        """The z of the lowest point in the sensor frame, in mm; a pad has an infinite radius.

        Raises ValueError if (x, y) is not over the skin.
        """
        if math.isinf(skin_radius_mm):
            return -self.depth_mm
        beside = skin_radius_mm**2 - self.x_mm**2 - self.y_mm**2
        if beside <= 0:
            raise ValueError(
                f"a press at x {self.x_mm}, y {self.y_mm} mm is not over the skin of radius "
                f"{skin_radius_mm} mm"
            )
        return math.sqrt(beside) - self.depth_mm

    @property
    def is_tilted(self) -> bool:
        """Whether the object's z axis differs from the sensor's."""
        return bool(self.tilt_x_deg or self.tilt_y_deg)

    @property
    def is_dragged(self) -> bool:
        """Whether the object moved along the skin after it touched."""
        return bool(self.drag_x_mm or self.drag_y_mm or self.twist_deg)

    def tilt(self) -> F64:
        """Rotation matrix (3, 3) of the tilt about x, then y."""
        b, c = math.radians(self.tilt_x_deg), math.radians(self.tilt_y_deg)
        about_x = np.array(
            ((1, 0, 0), (0, math.cos(b), -math.sin(b)), (0, math.sin(b), math.cos(b)))
        )
        about_y = np.array(
            ((math.cos(c), 0, math.sin(c)), (0, 1, 0), (-math.sin(c), 0, math.cos(c)))
        )
        return np.asarray(about_y @ about_x)

    def distance_mm(self, skin_radius_mm: float, points_mm: F64) -> F64:
        """Signed distance (N,) in mm of points (N, 3) in the sensor frame; of their dtype."""
        a = math.radians(self.rotation_deg)
        c, s = math.cos(a) / self.scale, math.sin(a) / self.scale
        x, y = points_mm[:, 0] - self.x_mm, points_mm[:, 1] - self.y_mm
        z = points_mm[:, 2] - self.origin_z_mm(skin_radius_mm)
        if self.is_tilted:
            x, y, z = (np.stack((x, y, z), axis=1) @ self.tilt().astype(points_mm.dtype)).T
        return (
            self.shape.sdf(np.stack((c * x + s * y, c * y - s * x, z / self.scale), axis=1))
            * self.scale
        )

    def origin_z_mm(self, skin_radius_mm: float) -> float:
        """The z of the object's origin in the sensor frame, in mm.

        Raises ValueError if (x, y) is not over the skin.
        """
        lowest = self.lowest_z_mm(skin_radius_mm)
        if not self.is_tilted:
            return lowest
        return lowest - self.scale * _lowest_mm(
            self.shape, self.rotation_deg, self.tilt_x_deg, self.tilt_y_deg
        )

    def before_drag(self, x_y_mm: F64) -> F64:
        """Positions (..., 2) in mm, when the object touched,
        of its points that are now at `x_y_mm`.
        """
        a = math.radians(self.twist_deg)
        # Its transpose turns forward.
        back = np.array(((math.cos(a), -math.sin(a)), (math.sin(a), math.cos(a))))
        origin = np.array((self.x_mm, self.y_mm))
        return np.asarray(
            (x_y_mm - origin) @ back + origin - np.array((self.drag_x_mm, self.drag_y_mm))
        )


_FALLEN_MM = 1e-4
_TALLEST_MM = 60.0  # twice the height of extruded shapes, so also of a shape that lies on its side


@functools.lru_cache(maxsize=256)
def _lowest_mm(shape: Shape, rotation_deg: float, tilt_x_deg: float, tilt_y_deg: float) -> float:
    """The z in mm of a tilted shape's lowest point over its origin;
    within 2 µm for shapes up to 40 mm wide.
    """
    upright = Press(shape, rotation_deg=rotation_deg)
    tilt = Press(shape, tilt_x_deg=tilt_x_deg, tilt_y_deg=tilt_y_deg).tilt()
    up = np.array((0.0, 0.0, upright.lowest_z_mm(100.0)))
    # Columns of points fall onto the shape, then finer ones around the lowest: half the width is 24
    # mm, then 1.2, 0.06 and 0.003. Distances may be too small, so each falls in steps.
    centre, half, lowest = np.zeros(2), 24.0, 0.0
    for _ in range(4):
        axis = np.linspace(-half, half, 61)
        x, y = (v.ravel() + c for v, c in zip(np.meshgrid(axis, axis), centre, strict=True))
        z = np.full(x.shape, -_TALLEST_MM)
        for _ in range(80):
            # Only points that may still be the lowest.
            low = z < float(z.min()) + half
            d = upright.distance_mm(100.0, np.stack((x[low], y[low], z[low]), axis=1) @ tilt + up)
            z[low] += np.maximum(d, 0)
            if float(d.max()) < _FALLEN_MM:
                break
            z[low & (z > _TALLEST_MM)] = _TALLEST_MM
        best = int(np.argmin(z))
        centre, lowest, half = np.array((x[best], y[best])), float(z[best]), half / 20
    return lowest


def distances_mm(presses: Sequence[Press], skin_radius_mm: float, points_mm: F64) -> F64:
    """Signed distances (presses, N), negative inside, from points (N,
    3) to each pressed object (at least one).
    """
    return np.stack([press.distance_mm(skin_radius_mm, points_mm) for press in presses])


def distance_mm(presses: Sequence[Press], skin_radius_mm: float, points_mm: F64) -> F64:
    """Signed distance (N,) in mm to the nearest pressed object: the least of `distances_mm`."""
    return np.asarray(distances_mm(presses, skin_radius_mm, points_mm).min(axis=0))
