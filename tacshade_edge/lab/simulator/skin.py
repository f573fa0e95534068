"""The skin's shape under objects: an obstacle problem on the sphere, or in the plane of a pad.

The skin is a membrane on an elastic foundation (the gel). Its inward displacement h along the
radius minimises ∫ λ²|∇h|² + h² over the sphere, subject to h >= 0 and to the skin staying outside
the objects. λ is the length over which the skirt around a contact decays. The grid lies in the
stereographic chart, centred on the apex. The chart is conformal: the Dirichlet term is that of the
plane, and only the mass term takes the factor (1 + ρ²/4)^-2.

A pad has an infinite radius; its chart is the plane itself, h is along -z, and the point (x, y, 0)
stands where a dome has the unit vector of a direction. Radius and size differ for a pad and for a
nearly flat dome: its grid's step and its rim are those of a dome whose radius is the size.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.lab.simulator.membrane import slid as slid
from tacshade_edge.lab.simulator.membrane import solve as solve
from tacshade_edge.lab.simulator.press import Press, distance_mm
from tacshade_edge.lab.simulator.sensor_model import RIM_HALF_ANGLE_DEG
from tacshade_edge.types import F32, F64

GRID_STEPS_PER_SIZE = 80
"""The grid's step is 1 / 80 of the skin's size at the apex: 0.25 mm on a dome of 20 mm."""

CLAMPED = 1e6
"""The mass weight beyond the rim: no skin moves there."""
# Finer than the lowest point of a tilted object, which `press` knows to 2 µm.
_TRACE_TOLERANCE_MM = 1e-4
# A few rays run along a wall, which would take hundreds of steps.
_LEAST_TRACE_MM = 2e-3
_TRACE_STEPS = 400
_OUTERMOST = 1.25
"""How far from O a leaning or bulging skin may reach, in skin radii."""
_ROUNDING = 1 + 1e-9
"""On a size that was divided and multiplied, so that it is not less than the radius
that it equals.
"""

Solver = Callable[[F32, F32], F32]
"""A function from an obstacle and mass weights to h, all on the same grid."""


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """A deformed skin; maps are float32 (2n+1, 2n+1), node (i,
    j) has chart coordinates ((j - n) step, (i - n) step).

    `obstacle_mm`: the least `pressed_mm` outside the objects; 0 where the node's ray meets none.
    `leaning_mm`: part of h due to the leaning dome. `origin_mm` (.., 2): chart coordinates without
    drag and sway of the material now at a node, minus the node's own. For each press, if one drags:
    `stuck`, the part of its contact that moves with it; `slid_mm`, how far along x and y it is
    ahead of the skin on average; `surplus`, the part of its drag that it could reverse without
    sticking anywhere. `rest_mm`: part of `pressed_mm` that remains without load, for a skin that
    creeps. `steps_per_size`: the skin's size in steps of the grid.
    """

    radius_mm: float
    step_mm: float
    height_mm: F32
    obstacle_mm: F32
    leaning_mm: F32 | None = None
    origin_mm: F32 | None = None
    stuck: tuple[float, ...] = ()
    slid_mm: tuple[tuple[float, float], ...] = ()
    surplus: tuple[float, ...] = ()
    rest_mm: F32 | None = None
    steps_per_size: int = GRID_STEPS_PER_SIZE

    def sample(self, x: F64, y: F64) -> F64:
        """Sample h at chart coordinates in mm (bilinear; 0 outside the grid)."""
        return bilinear(self.height_mm, x / self.step_mm, y / self.step_mm)

    def leaning(self, leaning_mm: F32 | None) -> Skin:
        """The same skin on a leaning dome: adds `leaning_mm` to h."""
        if leaning_mm is None:
            return self
        return replace(self, height_mm=self.height_mm + leaning_mm, leaning_mm=leaning_mm)

    @property
    def pressed_mm(self) -> F32:
        """The part of h due to objects, without the dome's lean, in mm, float32 (2n+1, 2n+1)."""
        return self.height_mm if self.leaning_mm is None else self.height_mm - self.leaning_mm

    def sample_pressed(self, x: F64, y: F64) -> F64:
        """Sample h without the dome's lean, as `sample` does."""
        height = self.sample(x, y)
        if self.leaning_mm is None:
            return height
        return height - bilinear(self.leaning_mm, x / self.step_mm, y / self.step_mm)

    def sample_origin(self, x: F64, y: F64) -> F64:
        """Sample `origin_mm` at chart coordinates in mm, (..., 2)."""
        if self.origin_mm is None:
            return np.zeros((*x.shape, 2))
        return np.stack(
            [
                bilinear(each, x / self.step_mm, y / self.step_mm)
                for each in np.moveaxis(self.origin_mm, 2, 0)
            ],
            axis=-1,
        )

    def carried_inwards(self, chart_mm: F64, friction: float) -> tuple[F64, F64]:
        """New directions (..., 3) and chart coordinates (..., 2) of material points under objects
        moving along -z, to first order in h: by h / cosθ along -z where the skin sticks (`friction`
        1), by h along the radius where it slides.
        """
        direction = chart_to_direction(chart_mm[..., 0], chart_mm[..., 1], self.radius_mm)
        if math.isinf(self.radius_mm):
            # The radius of a pad is its z: what sinks stays where it is in the chart.
            return direction, chart_mm
        height = self.sample_pressed(chart_mm[..., 0], chart_mm[..., 1])
        moved = direction * (self.radius_mm - (1 - friction) * height)[..., None]
        # h is measured along the radius; along -z the same surface is 1 / cosθ farther.
        moved[..., 2] -= friction * height / direction[..., 2]
        moved /= length_of(moved)[..., None]
        return moved, np.stack(direction_to_chart(moved, self.radius_mm), axis=-1)


def undeformed(
    radius_mm: float, size_mm: float | None = None, steps_per_size: int = GRID_STEPS_PER_SIZE
) -> Skin:
    """The undeformed skin; the size is the radius if none is given."""
    n, step = _grid(size_mm or radius_mm, steps_per_size)
    zero = np.zeros((2 * n + 1, 2 * n + 1), np.float32)
    return Skin(radius_mm, step, zero, zero, steps_per_size=steps_per_size)


def press_skin(
    radius_mm: float,
    decay_mm: float,
    presses: Sequence[Press],
    leaning_mm: F32 | None = None,
    rest_mm: F32 | None = None,
    solver: Solver = solve,
    size_mm: float | None = None,
) -> Skin:
    """Find the skin's shape under objects; `rest_mm` is that of the unloaded skin after creep.

    Raises ValueError (an object would reach the middle of the sensor, or is not over the skin).
    """
    flat = undeformed(radius_mm, size_mm)
    if not presses:
        free = flat if rest_mm is None else replace(flat, height_mm=rest_mm, rest_mm=rest_mm)
        return free.leaning(leaning_mm)
    obstacle = obstacle_of(radius_mm, presses, leaning_mm, size_mm)
    return skin_over(flat, obstacle, decay_mm, leaning_mm, rest_mm, solver)


def skin_over(
    flat: Skin,
    obstacle: F32,
    decay_mm: float,
    leaning_mm: F32 | None = None,
    rest_mm: F32 | None = None,
    solver: Solver = solve,
) -> Skin:
    """Find the shape of an undeformed skin over an obstacle on its grid, as `press_skin` does."""
    free = flat if rest_mm is None else replace(flat, height_mm=rest_mm, rest_mm=rest_mm)
    # What has crept carries no load: only what an object presses beyond it acts on the gel.
    beyond = obstacle if rest_mm is None else np.maximum(obstacle - rest_mm, 0)
    if not beyond.any():
        return flat if rest_mm is None else free.leaning(leaning_mm)
    weight = mass_weight_of(flat)
    # Nine decays away, less than exp(-9) of the depth is left: below the tolerance of `solve`.
    window = window_of(beyond > 0, 2 + math.ceil(9 * decay_mm / flat.step_mm))
    pressed = np.zeros_like(obstacle)
    pressed[window] = solver(
        np.ascontiguousarray(beyond[window]),
        weight[window] * np.float32((flat.step_mm / decay_mm) ** 2),
    )
    if rest_mm is not None:
        pressed += rest_mm
    return replace(free, height_mm=pressed, obstacle_mm=obstacle).leaning(leaning_mm)


def left_over(skin: Skin, part: float) -> Skin:
    """Make the shape that a creeping skin keeps for a while after a release:
    a weaker dent without the object.
    """
    weaker = np.float32(part)
    return replace(
        skin,
        height_mm=skin.height_mm * weaker,
        # The object is gone: nothing of the dent is a contact.
        obstacle_mm=np.zeros_like(skin.obstacle_mm),
        leaning_mm=None if skin.leaning_mm is None else skin.leaning_mm * weaker,
        origin_mm=None if skin.origin_mm is None else skin.origin_mm * weaker,
        stuck=(),
        slid_mm=(),
    )


def net_pull(skin: Skin, decay_mm: float) -> F32:
    """The pressure of the skin's nodes, in mm: (4 + m) h minus the sum of the neighbours;
    0 on the border.
    """
    h = skin.pressed_mm if skin.rest_mm is None else skin.pressed_mm - skin.rest_mm
    mass = mass_weight_of(skin) * np.float32((skin.step_mm / decay_mm) ** 2)
    # With the stencil of the solver, so that free skin, which it left in balance, has no pressure.
    pull = np.zeros_like(h)
    neighbours = h[:-2, 1:-1] + h[2:, 1:-1] + h[1:-1, :-2] + h[1:-1, 2:]
    pull[1:-1, 1:-1] = (4 + mass[1:-1, 1:-1]) * h[1:-1, 1:-1] - neighbours
    return pull


def chart_to_direction(x: F64, y: F64, radius_mm: float) -> F64:
    """Convert chart coordinates in mm to unit vectors from O, (..., 3);
    on a pad to the points of the plane.
    """
    if math.isinf(radius_mm):
        return np.stack((x, y, np.zeros_like(x)), axis=-1)
    u, v = x / radius_mm, y / radius_mm
    q = (u * u + v * v) / 4
    return np.stack((u, v, 1 - q), axis=-1) / (1 + q)[..., None]


def direction_to_chart(direction: F64, radius_mm: float) -> tuple[F64, F64]:
    """Convert vectors from O (any length, not along -z) to chart coordinates in mm;
    on a pad points of any height.
    """
    if math.isinf(radius_mm):
        return direction[..., 0], direction[..., 1]
    # The projection is from the pole at -z: infinite only there, far beyond the clamped rim.
    k = 2 * radius_mm / (length_of(direction) + direction[..., 2])
    return direction[..., 0] * k, direction[..., 1] * k


def length_of(vectors: F64) -> F64:
    """Lengths (...) of vectors (..., 3), to the bit as np.linalg.norm, in a third of its time."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def at_height(direction: F64, height: F64 | F32, radius_mm: float) -> F64:
    """Points (..., 3) in mm of the skin with a height
    (...) in a direction of `chart_to_direction`.
    """
    if math.isinf(radius_mm):
        lowered = direction.copy()
        lowered[..., 2] -= height
        return lowered
    return np.asarray(direction * (radius_mm - height)[..., None])


def rest_x_y_mm(chart_mm: F64, radius_mm: float) -> F64:
    """The x and y (N, 2) in mm of the undeformed skin at chart coordinates (N, 2)."""
    if math.isinf(radius_mm):
        return chart_mm
    return radius_mm * chart_to_direction(chart_mm[:, 0], chart_mm[:, 1], radius_mm)[:, :2]


def height_of(points_mm: F64, radius_mm: float) -> F64:
    """Heights (N,) in mm of points (N, 3) of the skin."""
    if math.isinf(radius_mm):
        return np.asarray(-points_mm[:, 2])
    return np.asarray(radius_mm - np.linalg.norm(points_mm, axis=1))


def _grid(size_mm: float, steps_per_size: int = GRID_STEPS_PER_SIZE) -> tuple[int, float]:
    step = size_mm / steps_per_size
    return math.ceil(2 * size_mm * math.tan(math.radians(RIM_HALF_ANGLE_DEG / 2)) / step), step


def mass_weight_of(skin: Skin) -> F32:
    """The chart's factor on the mass term at a skin's nodes."""
    n = len(skin.height_mm) // 2
    return mass_weight(skin.radius_mm, skin.step_mm, n, skin.steps_per_size)


def mass_weight(
    radius_mm: float, step_mm: float, n: int, steps_per_size: int = GRID_STEPS_PER_SIZE
) -> F32:
    """The chart's factor on the mass term; beyond the rim it is so large
    that the skin cannot move.
    """
    node = np.arange(-n, n + 1)

    def squares(of_mm: float) -> F64:
        axis = (node * (step_mm / of_mm)) ** 2 / 4
        return axis[:, None] + axis[None, :]

    # The size comes back from the step, which was divided by it: rounding may have made it less
    # than the radius, and the rim another one.
    q, size_mm = squares(radius_mm), min(radius_mm, step_mm * steps_per_size * _ROUNDING)
    to_rim = q if size_mm == radius_mm else squares(size_mm)
    clamped = to_rim > math.tan(math.radians(RIM_HALF_ANGLE_DEG / 2)) ** 2
    return np.asarray(np.where(clamped, CLAMPED, 1 / (1 + q) ** 2), np.float32)


def node_directions(
    radius_mm: float, size_mm: float | None = None, steps_per_size: int = GRID_STEPS_PER_SIZE
) -> F64:
    """Directions (2n+1, 2n+1, 3) of the grid's nodes (`chart_to_direction`), single precision."""
    return _directions(radius_mm, *_grid(size_mm or radius_mm, steps_per_size))


@functools.lru_cache(maxsize=8)
def _directions(radius_mm: float, n: int, step_mm: float) -> F64:
    axis = np.arange(-n, n + 1, dtype=np.float32) * np.float32(step_mm)
    x, y = np.meshgrid(axis, axis)
    directions = chart_to_direction(x, y, radius_mm)
    directions.flags.writeable = False
    return directions


def obstacle_of(
    radius_mm: float,
    presses: Sequence[Press],
    leaning_mm: F32 | None = None,
    size_mm: float | None = None,
) -> F32:
    """The skin's distance from O minus the distance at which each node's ray enters an object;
    0 if it enters none.
    """
    size_mm = size_mm or radius_mm
    at_rest = np.float32(size_mm if math.isinf(radius_mm) else radius_mm)
    surface = at_rest if leaning_mm is None else at_rest - leaning_mm
    # Where an object lies does not depend on how it came there; without the drag, an object that is
    # dragged on the spot is traced once.
    still = tuple(replace(press, drag_x_mm=0.0, drag_y_mm=0.0, twist_deg=0.0) for press in presses)
    return np.asarray(np.maximum(surface - _entries(radius_mm, size_mm, still), 0), np.float32)


# Two: a sway, which moves the skin and not the object, solves the same presses again, and so does
# what bulges.
@functools.lru_cache(maxsize=2)
def _entries(radius_mm: float, size_mm: float, presses: tuple[Press, ...]) -> F32:
    """The distance from O at which each node's ray enters an object, infinite if none; the last
    ones are kept. The rays of a pad are along z and begin at its size below the skin.
    """
    rays, flat = _directions(radius_mm, *_grid(size_mm)), math.isinf(radius_mm)
    origins = np.zeros((1, 3)) if not flat else (rays - (0, 0, size_mm)).reshape(-1, 3)
    start = float(distance_mm(presses, radius_mm, origins).min())
    # Rays start as far from O as the nearest object; one around O leaves no way in.
    if start < 0.1 * size_mm:
        raise ValueError(f"the press reaches the sensor's centre (skin radius {radius_mm} mm)")
    entries = np.full(rays.shape[:2], np.inf, np.float32)
    index = np.flatnonzero(_within_rim(rays, radius_mm, size_mm))
    ray, end = rays.reshape(-1, 3)[index], np.float32(_OUTERMOST * size_mm)
    # O of a nearly flat dome lies deeper below its skin than its size.
    if not flat and radius_mm > size_mm:
        end += np.float32(radius_mm - size_mm)
    t: F32 = np.full(len(index), start, np.float32)
    for _ in range(_TRACE_STEPS):
        at = np.column_stack((ray[:, :2], t - np.float32(size_mm))) if flat else ray * t[:, None]
        # Sphere tracing (Hart 1996): nothing is nearer than the distance, so no step jumps through
        # a wall.
        d = distance_mm(presses, radius_mm, at)
        hit = d < _TRACE_TOLERANCE_MM
        # Back out of what the least step entered.
        entries.flat[index[hit]] = t[hit] + np.minimum(d[hit], 0)
        t = (t + np.maximum(d, _LEAST_TRACE_MM)).astype(np.float32)
        on = ~hit & (t < end)
        index, ray, t = index[on], ray[on], t[on]
        if not len(index):
            break
    entries.flags.writeable = False  # everyone gets the cache's array
    return entries


def _within_rim(rays: F64, radius_mm: float, size_mm: float) -> np.typing.NDArray[np.bool_]:
    """The nodes inside the rim, (2n+1, 2n+1), from their directions."""
    if radius_mm == size_mm:
        return np.asarray(rays[..., 2] > math.cos(math.radians(RIM_HALF_ANGLE_DEG)))
    rim_mm = 2 * size_mm * math.tan(math.radians(RIM_HALF_ANGLE_DEG / 2))
    x, y = direction_to_chart(rays, radius_mm)
    return np.asarray(x * x + y * y < rim_mm * rim_mm)


def window_of(where: np.typing.NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """The bounding box of the True cells with a margin, clipped to the grid."""
    sides = []
    for axis in (1, 0):
        hit = np.flatnonzero(where.any(axis=axis))
        sides.append(slice(max(int(hit[0]) - margin, 0), int(hit[-1]) + margin + 1))
    return sides[0], sides[1]


def bilinear(grid: F32, x: F64, y: F64) -> F64:
    """Sample at (x, y) steps from the middle node; 0 outside.
    cv2.remap would round to 1/32 step.
    """
    n = grid.shape[0] // 2
    col, row = np.clip(x + n, 0, 2 * n), np.clip(y + n, 0, 2 * n)
    j, i = np.minimum(col.astype(np.intp), 2 * n - 1), np.minimum(row.astype(np.intp), 2 * n - 1)
    a, b = col - j, row - i
    k = i * (2 * n + 1) + j
    flat = grid.ravel()
    top = flat[k] * (1 - a) + flat[k + 1] * a
    bottom = flat[k + 2 * n + 1] * (1 - a) + flat[k + 2 * n + 2] * a
    return np.asarray(top * (1 - b) + bottom * b)
