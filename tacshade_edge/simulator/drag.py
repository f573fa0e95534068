"""Skin that is moved along itself: a tangential contact problem on the skin's grid.

The same membrane on an elastic foundation as in `skin`: the tangential displacement w minimises ∫ λt²|∇w|² + w² with a
traction q = kt (w - λt²∇²w) where objects touch. There the skin goes with the object (sticks) as far as Coulomb's law
|q| <= μ p allows, with the pressure p = kn (h - λ²∇²h) of the normal problem, and slides under it elsewhere: the static
problem of friction at a given pressure (Duvaut and Lions 1976, ch. III; Johnson, Contact Mechanics, 1985, ch. 7). For
λt = λ the traction is the difference of two such pressures (Ciavarella 1998; Jäger 1998), which is what Cattaneo and
Mindlin found for balls on a half space.

The dome gives way as a whole, too: it leans like a short beam that the housing clamps at the rim (`leant_mm`). Skin and
dome are springs in series, so what slides loads neither further. And a dome full of gel, which keeps its volume, bulges
beside what is pressed into it (`bulged_mm`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.simulator.model import RIM_HALF_ANGLE_DEG, SensorModel
from tacshade_edge.simulator.press import Press, distances_mm
from tacshade_edge.simulator.skin import (
    Skin,
    direction_to_chart,
    mass_weight,
    net_pull,
    node_directions,
    obstacle_of,
    undeformed,
)
from tacshade_edge.types import F32, F64, I64

_EVERY = 2  # nodes of the skin's grid to one of this one's: w is smooth
_SWEEPS = 400
_TOLERANCE_MM = 1e-3
_RELAXATION = 1.7
_TOUCHING_MM = 1e-3
_STUCK_MM = 0.02
_STEEPEST = 0.75  # of w over λt, and of any change of the origin: skin that would fold slides
_SWAY_TOLERANCE_MM = 0.05

Shape = Callable[[F32 | None], Skin]
"""From `Skin.leaning_mm` to the skin that presses shape, as `skin.press_skin` does."""


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """Nodes of a grid that touch.

    Attributes
    ----------
    rows, cols : int (N,)
    owner : int (N,)
        Which press.
    held_mm : float (N, 2)
        w that sticks, in mm of the chart.
    pressure_mm : float (N,)
        p / kn.
    """

    rows: I64
    cols: I64
    owner: I64
    held_mm: F64
    pressure_mm: F64


@dataclass(frozen=True, slots=True)
class Mechanics:
    """How a skin gives way along itself.

    Attributes
    ----------
    lean : callable
        How the leaning dome moves its skin: (..., 3) mm at unit vectors (..., 3), by a sway (2,) in mm at the apex.
    carry : callable
        w, float32 (2, rows, cols) in mm of the chart, from the contacts, the grid's weights of mass
        (`skin.mass_weight`), its step in mm and the model.
    """

    lean: Callable[[F64, F64], F64]
    carry: Callable[[Contacts, F32, float, SensorModel], F32]


def drag_skin(shape: Shape, model: SensorModel, presses: Sequence[Press], mechanics: Mechanics | None = None) -> Skin:
    """Shape a skin under presses, some of which drag it.

    Parameters
    ----------
    shape : callable
        Solves the normal problem of `presses`.
    model : SensorModel
    presses : sequence of Press
    mechanics : Mechanics, optional
        Other ones than `MEMBRANE`.
    """
    mechanics = mechanics or MEMBRANE
    if not presses or not (model.bulge or any(press.is_dragged for press in presses)):
        return shape(None)
    sway_mm = model.sway * np.mean([(press.drag_x_mm, press.drag_y_mm) for press in presses], axis=0)
    skin, carried_mm = _swaying(shape, model, presses, mechanics, sway_mm)
    loaded_mm = carried_mm * (model.sway / (1 - model.sway))
    if np.abs(loaded_mm - sway_mm).max() > _SWAY_TOLERANCE_MM:  # something slid
        skin, _ = _swaying(shape, model, presses, mechanics, loaded_mm)
    return skin


def leant_mm(direction: F64, sway_mm: F64) -> F64:
    """How the leaning dome moves its skin: (..., 3) mm at unit vectors (..., 3), by `sway_mm` (2,) at the apex.

    It shears from the rim up, and turns by half as much, as a beam does that is as long as it is wide.
    """
    low = math.cos(math.radians(RIM_HALF_ANGLE_DEG))
    up = np.clip((direction[..., 2] - low) / (1 - low), 0, 1)
    turn = np.minimum(up / 0.1, 1) * (direction[..., :2] @ sway_mm) * (0.5 / (1 - low))  # nothing moves at the rim
    return np.concatenate((up[..., None] * sway_mm, -turn[..., None]), axis=-1)


def bulged_mm(direction: F64, volume_mm3: float, radius_mm: float) -> F64:
    """How the sides of the dome move outwards, (..., 3) mm at unit vectors (..., 3), by so much volume in all."""
    rim = math.radians(RIM_HALF_ANGLE_DEG)
    angle = np.minimum(np.arccos(np.clip(direction[..., 2], -1, 1)) / rim, 1)
    inner = np.linspace(0, rim, 200)
    area_mm2 = 2 * math.pi * radius_mm**2 * float(np.mean(np.sin(math.pi * inner / rim) ** 2 * np.sin(inner))) * rim
    return np.asarray((volume_mm3 / area_mm2 * np.sin(math.pi * angle) ** 2)[..., None] * direction)


def _displaced_mm3(radius_mm: float, presses: Sequence[Press]) -> float:
    """Volume of the objects inside the undeformed skin, as seen from O; to first order in h."""
    obstacle = obstacle_of(radius_mm, presses)
    step_mm = undeformed(radius_mm).step_mm
    weight = mass_weight(radius_mm, step_mm, len(obstacle) // 2)  # is the area's, inside the rim
    return float(np.sum(obstacle * np.minimum(weight, 1))) * step_mm**2


def _swaying(
    shape: Shape, model: SensorModel, presses: Sequence[Press], mechanics: Mechanics, sway_mm: F64
) -> tuple[Skin, F64]:
    """The skin of a dome that leans by `sway_mm`, and how far contacts carry it beyond that, in the mean: (2,) mm."""
    radius_mm = model.skin_radius_mm
    direction = node_directions(radius_mm).astype(np.float64)
    moved = mechanics.lean(direction, sway_mm)
    if model.bulge:
        moved += bulged_mm(direction, model.bulge * _displaced_mm3(radius_mm, presses), radius_mm)
    skin = shape(np.asarray(-np.sum(moved * direction, axis=-1), np.float32) if moved.any() else None)
    node, before = (
        np.stack(direction_to_chart(at, radius_mm), axis=-1) for at in (direction, radius_mm * direction - moved)
    )
    contacts = _contacts(skin, direction, node - before, model, presses)
    weight = mass_weight(radius_mm, skin.step_mm, len(node) // 2)[::_EVERY, ::_EVERY]
    carried = mechanics.carry(contacts, weight, skin.step_mm * _EVERY, model)
    at_contacts = carried[:, contacts.rows, contacts.cols].T
    sticks = np.linalg.norm(at_contacts - contacts.held_mm, axis=1) < _STUCK_MM
    counts, stuck = (np.bincount(contacts.owner[which], minlength=len(presses)) for which in (slice(None), sticks))
    origin = np.asarray(before - node - np.moveaxis(_finer(carried, node.shape[:2]), 0, 2), np.float32)
    dragged = replace(
        skin,
        origin_mm=_unfolded(origin, skin.step_mm),
        stuck=tuple(float(s / c) if c else 1.0 for s, c in zip(stuck, counts, strict=True)),
    )
    return dragged, at_contacts.mean(axis=0) if len(at_contacts) else np.zeros(2)


def _contacts(skin: Skin, direction: F64, leant: F64, model: SensorModel, presses: Sequence[Press]) -> Contacts:
    every = slice(None, None, _EVERY)
    pressed, obstacle = skin.pressed_mm, skin.obstacle_mm
    rows, cols = np.nonzero(((obstacle > 0) & (pressed <= obstacle + _TOUCHING_MM))[every, every])
    points = (direction * (skin.radius_mm - skin.height_mm)[..., None])[every, every][rows, cols]
    if not len(points):
        return Contacts(rows, cols, np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0))
    owner = np.argmin(distances_mm(presses, skin.radius_mm, points), axis=0)
    touched = points[:, :2].copy()
    for k, press in enumerate(presses):
        touched[owner == k] = press.before_drag(points[owner == k, :2])
    # What goes along -z with an object keeps its x and y, so these say where on the skin it was.
    held = _chart_over(points[:, :2], skin.radius_mm) - _chart_over(touched, skin.radius_mm)
    held -= leant[every, every][rows, cols]
    pressure_mm = np.maximum(net_pull(skin, model.skin_decay_mm), 0) * np.float32(
        (model.skin_decay_mm / skin.step_mm) ** 2
    )
    # Edges press along lines, which the coarse grid's nodes share.
    pressure_mm = cv2.sepFilter2D(pressure_mm, -1, np.array((0.25, 0.5, 0.25)), np.array((0.25, 0.5, 0.25)))
    return Contacts(rows, cols, owner, held, pressure_mm[every, every][rows, cols])


def carry(contacts: Contacts, weight: F32, step_mm: float, model: SensorModel) -> F32:
    """`Mechanics.carry` of the membrane: `slid` under Coulomb's law."""
    steepest = _STEEPEST * model.drag_decay_mm / np.maximum(np.linalg.norm(contacts.held_mm, axis=1), 1e-9)
    nodes = (step_mm / model.drag_decay_mm) ** 2
    held, limit = np.zeros((2, *weight.shape), np.float32), np.zeros(weight.shape, np.float32)
    held[:, contacts.rows, contacts.cols] = (contacts.held_mm * np.minimum(steepest, 1)[:, None]).T
    limit[contacts.rows, contacts.cols] = contacts.pressure_mm * (model.coulomb * nodes)
    return slid(held, limit, weight * np.float32(nodes))


MEMBRANE = Mechanics(leant_mm, carry)


def slid(held: F32, limit: F32, mass: F32) -> F32:
    """Solve (4 + m) w - sum of the neighbours = r where |r| is at most a limit, w as held where that is enough.

    Parameters
    ----------
    held : float32 (2, rows, cols)
        w that sticks.
    limit : float32 (rows, cols)
        Above 0 where something touches.
    mass : float32 (rows, cols)

    Returns
    -------
    float32 (2, rows, cols)
        w; 0 on the border. Projected red-black over-relaxation, begun on a grid of a quarter of the nodes.
    """
    rows, cols = mass.shape
    if min(mass.shape) >= 24:
        coarse = slid(*(np.ascontiguousarray(a[..., ::2, ::2]) for a in (held, limit * 4, mass * 4)))
        w = np.where(limit > 0, held, _finer(coarse, mass.shape))
    else:
        w = held.copy()
    w[:, 0] = w[:, -1] = 0
    w[:, :, 0] = w[:, :, -1] = 0
    planes = []
    for i, j in ((1, 1), (2, 2), (1, 2), (2, 1)):
        r, c = slice(i, rows - 1, 2), slice(j, cols - 1, 2)
        near = (
            (slice(i - 1, rows - 2, 2), c),
            (slice(i + 1, rows, 2), c),
            (r, slice(j - 1, cols - 2, 2)),
            (r, slice(j + 1, cols, 2)),
        )
        diagonal = np.ascontiguousarray(4 + mass[r, c])
        planes.append(
            (
                w[:, r, c],
                [w[:, *n] for n in near],
                held[:, r, c] * diagonal,
                np.ascontiguousarray(limit[r, c]),
                1 / diagonal,
            )
        )
    for _ in range(_SWEEPS):
        change = 0.0
        for centre, neighbours, stuck, most, gain in planes:
            total = neighbours[0] + neighbours[1]
            total += neighbours[2]
            total += neighbours[3]
            traction = stuck - total
            size = np.sqrt(traction[0] ** 2 + traction[1] ** 2)
            traction *= np.minimum(most / np.maximum(size, 1e-12), 1)
            total += traction
            total *= gain
            total -= centre
            change = max(change, float(np.abs(total).max(initial=0)))
            centre += np.float32(_RELAXATION) * total
        if change < _TOLERANCE_MM * (2 - _RELAXATION):
            break
    return w


def _finer(coarse: F32, shape: tuple[int, int]) -> F32:
    """(2, rows, cols) on a grid of twice the step to one of a shape: its node (2i, 2j) is (i, j) of the coarse one."""
    to_coarse = np.array(((0.5, 0, 0), (0, 0.5, 0)))
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.stack(
        [cv2.warpAffine(c, to_coarse, shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE) for c in coarse]
    )


def _unfolded(origin_mm: F32, step_mm: float) -> F32:
    """Weaken displacements that would fold the skin over itself, as between two contacts that meet."""
    while True:
        (xx, yx), (xy, yy) = ([np.gradient(origin_mm[..., k], step_mm, axis=axis) for k in (0, 1)] for axis in (1, 0))
        if float(((1 + xx) * (1 + yy) - xy * yx).min()) > 1 - _STEEPEST:
            return origin_mm
        origin_mm = origin_mm * np.float32(0.9)


def _chart_over(x_y_mm: F64, radius_mm: float) -> F64:
    """Chart coordinates (N, 2) of the undeformed skin at x and y; of its equator where there is none."""
    rho = np.linalg.norm(x_y_mm, axis=1, keepdims=True)
    on = x_y_mm * np.minimum(1, 0.999 * radius_mm / np.maximum(rho, 1e-9))
    z = np.sqrt(radius_mm**2 - np.sum(on * on, axis=1))
    return np.stack(direction_to_chart(np.column_stack((on, z)), radius_mm), axis=-1)
