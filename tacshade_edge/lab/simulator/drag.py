"""Drag the skin along itself: a tangential contact problem on the skin's grid.

The tangential displacement w of the membrane of `skin` minimises ∫ λt²|∇w|² + w² with a traction
q = kt (w - λt²∇²w) where objects touch. There the skin sticks as far as Coulomb's law |q| <= μ p
allows, with the pressure p = kn (h - λ²∇²h), and slides elsewhere: friction at a given pressure
(Johnson, Contact Mechanics, 1985, ch. 7). For λt = λ, the traction is the difference of two such
pressures (Ciavarella 1998; Jäger 1998).

The dome also leans and bulges (`leaning`); skin and dome are springs in series. The problem is
static: a contact that slid sticks again at once when the object turns back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from tacshade_edge.lab.simulator.leaning import bulged_mm, displaced_mm3, swayed_mm
from tacshade_edge.lab.simulator.leaning import leant_mm as leant_mm
from tacshade_edge.lab.simulator.membrane import finer, slid, solve
from tacshade_edge.lab.simulator.press import Press, distances_mm
from tacshade_edge.lab.simulator.sensor_model import RIM_HALF_ANGLE_DEG, SensorModel
from tacshade_edge.lab.simulator.skin import (
    CLAMPED,
    GRID_STEPS_PER_SIZE,
    Skin,
    Solver,
    at_height,
    direction_to_chart,
    mass_weight_of,
    net_pull,
    node_directions,
    press_skin,
    rest_x_y_mm,
)
from tacshade_edge.types import F32, F64, I64

# Step of this grid in nodes of the grid of the skin: w is smooth, and so costs a quarter.
_EVERY = 2
_TOUCHING_MM = 1e-3
_STUCK_MM = 0.02
# Limit of w over λt, and of any change of the origin: skin that would fold slides. Below 1, what
# `render.carried` iterates is a contraction.
_STEEPEST = 0.75
SWAY_TOLERANCE_MM = 0.05
_LEAST_MM = 1e-9  # a displacement that is divided by

Shape = Callable[[F32 | None], Skin]
"""A function from `Skin.leaning_mm` to the skin shaped by the presses, as in `skin.press_skin`."""


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """The nodes (N,) of a grid in contact, each with the index of its press: w (N, 2) if it sticks,
    in mm of the chart; chart coordinates (N, 2) of the undeformed skin at the x and y where the
    object touched it, before the drag; p / kn.
    """

    rows: I64
    cols: I64
    owner: I64
    held_mm: F64
    touched_mm: F64
    pressure_mm: F64


@dataclass(frozen=True, slots=True)
class DragMechanics:
    """How a skin yields along itself.

    `lean`: displacement of the leaning dome's skin, (..., 3) mm, from unit vectors (..., 3) and a
    sway (2,) in mm at the apex. `carry`: w (2, rows, cols) in mm of the chart, from the contacts,
    the grid's mass weights (`skin.mass_weight`), its step and the model. `assume`: a first sway
    (2,) in mm, from that of contacts that all stick.
    """

    lean: Callable[[F64, F64], F64]
    carry: Callable[[Contacts, F32, float, SensorModel], F32]
    assume: Callable[[F64], F64] = lambda sway_mm: sway_mm


def drag_skin(
    shape: Shape,
    model: SensorModel,
    presses: Sequence[Press],
    mechanics: DragMechanics | None = None,
    rest: Skin | None = None,
    steps_per_size: int = GRID_STEPS_PER_SIZE,
) -> Skin:
    """Shape a skin under presses, some of which drag it; `shape` solves their normal problem on a
    grid of these steps.

    `rest`, the unloaded skin after creep, adds its lean and tangential displacement.
    """
    mechanics = mechanics or MEMBRANE
    if not presses or not (model.bulge or any(press.is_dragged for press in presses)):
        skin = shape(None if rest is None else rest.leaning_mm)
        return skin if rest is None else replace(skin, origin_mm=rest.origin_mm)
    sway_mm = model.sway * np.mean(
        [(press.drag_x_mm, press.drag_y_mm) for press in presses], axis=0
    )
    direction = node_directions(*model.form_mm, steps_per_size).astype(np.float64)
    sway_mm = mechanics.assume(sway_mm)
    swaying = partial(_swaying, shape, model, presses, mechanics, rest, direction)
    skin, carried_mm = swaying(sway_mm)
    # Skin and dome are springs in series: what the contacts carry along the skin loads the dome. If
    # nothing slid, this is the sway that was assumed.
    loaded_mm = carried_mm * (model.sway / (1 - model.sway))
    if np.abs(loaded_mm - sway_mm).max() > SWAY_TOLERANCE_MM:  # a contact slid
        skin, _ = swaying(loaded_mm)
    return skin


def _swaying(
    shape: Shape,
    model: SensorModel,
    presses: Sequence[Press],
    mechanics: DragMechanics,
    rest: Skin | None,
    direction: F64,
    sway_mm: F64,
) -> tuple[Skin, F64]:
    """The skin of a dome that leans by `sway_mm`, and the mean further displacement
    by the contacts, (2,) mm.
    """
    radius_mm, _ = model.form_mm
    moved, leaning = _leaning(direction, model, presses, mechanics, sway_mm)
    if rest is not None and rest.leaning_mm is not None:
        leaning = rest.leaning_mm if leaning is None else leaning + rest.leaning_mm
    skin = shape(leaning)
    node, before = (
        np.stack(direction_to_chart(at, radius_mm), axis=-1)
        for at in (direction, at_height(direction, np.zeros(1), radius_mm) - moved)
    )
    if rest is not None and rest.origin_mm is not None:
        before += rest.origin_mm
    leant = node - before
    contacts = _contacts(skin, direction, leant, model, presses)
    weight = mass_weight_of(skin)[::_EVERY, ::_EVERY]
    carried = mechanics.carry(contacts, weight, skin.step_mm * _EVERY, model)
    at_contacts = carried[:, contacts.rows, contacts.cols].T
    origin = np.asarray(
        before - node - np.moveaxis(finer(carried, node.shape[:2]), 0, 2), np.float32
    )
    moved_mm = contacts.held_mm + leant[::_EVERY, ::_EVERY][contacts.rows, contacts.cols]
    dragged = _dragged(skin, contacts, at_contacts, moved_mm, origin, len(presses))
    return dragged, at_contacts.mean(axis=0) if len(at_contacts) else np.zeros(2)


def _leaning(
    direction: F64,
    model: SensorModel,
    presses: Sequence[Press],
    mechanics: DragMechanics,
    sway_mm: F64,
) -> tuple[F64, F32 | None]:
    """How far the unloaded skin moves at the grid's nodes, (..., 3) mm, and `Skin.leaning_mm`."""
    radius_mm, size_mm = model.form_mm
    if math.isinf(radius_mm):
        # A pad shears along itself, which changes no height.
        return swayed_mm(direction, sway_mm, size_mm), None
    moved = mechanics.lean(direction, sway_mm)
    if model.bulge:
        displaced = model.bulge * displaced_mm3(radius_mm, presses)
        moved += bulged_mm(direction, displaced, radius_mm)
    if not moved.any():
        return moved, None
    return moved, np.asarray(-np.sum(moved * direction, axis=-1), np.float32)


def _dragged(
    skin: Skin, contacts: Contacts, at_contacts: F32, moved_mm: F64, origin: F32, presses: int
) -> Skin:
    """The skin with what drags it: w (N, 2) at the contacts, how far these moved in all, and
    `Skin.origin_mm` before skin that would fold slides.
    """
    ahead = contacts.held_mm - at_contacts
    lag_mm = np.linalg.norm(ahead, axis=1)
    sticks = lag_mm < _STUCK_MM
    surplus = np.where(
        sticks, 0.0, lag_mm / np.maximum(np.linalg.norm(moved_mm, axis=1), _LEAST_MM)
    )
    owners = [contacts.owner == k for k in range(presses)]
    part = _unfolded_part(origin, skin.step_mm)
    # What an unfolding takes away from the drag, the object slides further.
    ahead -= (1 - part) * origin[::_EVERY, ::_EVERY][contacts.rows, contacts.cols]
    touched, now = (
        rest_x_y_mm(at, skin.radius_mm) for at in (contacts.touched_mm, contacts.touched_mm + ahead)
    )
    return replace(
        skin,
        origin_mm=origin * np.float32(part),
        stuck=tuple(float(sticks[mine].mean()) if mine.any() else 1.0 for mine in owners),
        slid_mm=tuple(_mean(now[mine] - touched[mine]) for mine in owners),
        surplus=tuple(
            float(surplus[mine].min(initial=1.0)) if mine.any() else 0.0 for mine in owners
        ),
    )


def _mean(vectors: F64) -> tuple[float, float]:
    x, y = vectors.mean(axis=0) if len(vectors) else (0.0, 0.0)
    return float(x), float(y)


def contact_nodes(
    skin: Skin, direction: F64, presses: Sequence[Press]
) -> tuple[I64, I64, I64, F64]:
    """Every other node in contact: its row and column on that coarse grid, its press,
    and its point (N, 3) in mm.
    """
    every = slice(None, None, _EVERY)
    pressed, obstacle = skin.pressed_mm, skin.obstacle_mm
    rows, cols = np.nonzero(((obstacle > 0) & (pressed <= obstacle + _TOUCHING_MM))[every, every])
    points = at_height(direction, skin.height_mm, skin.radius_mm)[every, every][rows, cols]
    if not len(points):
        return rows, cols, np.zeros(0, np.int64), points
    return rows, cols, np.argmin(distances_mm(presses, skin.radius_mm, points), axis=0), points


def _contacts(
    skin: Skin, direction: F64, leant: F64, model: SensorModel, presses: Sequence[Press]
) -> Contacts:
    every = slice(None, None, _EVERY)
    rows, cols, owner, points = contact_nodes(skin, direction, presses)
    if not len(points):
        return Contacts(rows, cols, owner, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    before = points[:, :2].copy()
    for k, press in enumerate(presses):
        before[owner == k] = press.before_drag(points[owner == k, :2])
    # Skin that moves along -z with an object keeps its x and y,
    # which therefore locate it on the undeformed skin.
    touched = _chart_over(before, skin.radius_mm)
    held = _chart_over(points[:, :2], skin.radius_mm) - touched
    held -= leant[every, every][rows, cols]
    pressure_mm = np.maximum(net_pull(skin, model.skin_decay_mm), 0) * np.float32(
        (model.skin_decay_mm / skin.step_mm) ** 2
    )
    # Edges press along lines; smoothing shares their pressure among the coarse grid's nodes.
    pressure_mm = cv2.sepFilter2D(
        pressure_mm, -1, np.array((0.25, 0.5, 0.25)), np.array((0.25, 0.5, 0.25))
    )
    return Contacts(rows, cols, owner, held, touched, pressure_mm[every, every][rows, cols])


def carry(
    contacts: Contacts,
    weight: F32,
    step_mm: float,
    model: SensorModel,
    solver: Callable[[F32, F32, F32], F32] = slid,
) -> F32:
    """`Mechanics.carry` of the membrane: `slid` under Coulomb's law."""
    asked_mm = np.linalg.norm(contacts.held_mm, axis=1)
    steepest = _STEEPEST * model.drag_decay_mm / np.maximum(asked_mm, _LEAST_MM)
    # The equation of `slid` is that of the membrane times (step / λt)², and so is its limit: μ p =
    # μ kn (h - λ²∇²h), over kt.
    nodes = (step_mm / model.drag_decay_mm) ** 2
    held, limit = np.zeros((2, *weight.shape), np.float32), np.zeros(weight.shape, np.float32)
    held[:, contacts.rows, contacts.cols] = (contacts.held_mm * np.minimum(steepest, 1)[:, None]).T
    limit[contacts.rows, contacts.cols] = contacts.pressure_mm * (model.coulomb * nodes)
    return solver(held, limit, weight * np.float32(nodes))


MEMBRANE = DragMechanics(leant_mm, carry)


def _unfolded_part(origin_mm: F32, step_mm: float) -> float:
    """The factor on displacements that keeps the skin from folding over itself, as between contacts
    that meet; continuous, so that a long drag does not jump.
    """
    (xx, yx), (xy, yy) = (
        [np.gradient(origin_mm[..., k], step_mm, axis=axis) for k in (0, 1)] for axis in (1, 0)
    )
    # The area of a node's cell is 1 + part * trace + part² * determinant,
    # and must be 1 - _STEEPEST at least.
    trace, determinant = xx + yy, xx * yy - xy * yx
    under = trace * trace - 4 * _STEEPEST * determinant
    steepest = float((np.sqrt(np.maximum(under, 0)) - trace)[under >= 0].max(initial=0))
    return min(1.0, 2 * _STEEPEST / max(steepest, 1e-9))


def _chart_over(x_y_mm: F64, radius_mm: float) -> F64:
    """Chart coordinates (N, 2) of the undeformed skin at x and y;
    beyond the skin, those of its equator.
    """
    if math.isinf(radius_mm):
        return x_y_mm
    rho = np.linalg.norm(x_y_mm, axis=1, keepdims=True)
    # Just inside the equator, so that rounding makes no root of a negative number below.
    on = x_y_mm * np.minimum(1, 0.999 * radius_mm / np.maximum(rho, _LEAST_MM))
    z = np.sqrt(radius_mm**2 - np.sum(on * on, axis=1))
    return np.stack(direction_to_chart(np.column_stack((on, z)), radius_mm), axis=-1)


_RIM = math.cos(math.radians(RIM_HALF_ANGLE_DEG))


def two_scale_skin(
    model: SensorModel,
    presses: Sequence[Press],
    leaning_mm: F32 | None = None,
    solver: Solver = solve,
) -> Skin:
    """Mix two skins into a stiff surface over a soft depth, whose skirt is not exponential."""
    near, far = (
        press_skin(
            model.skin_radius_mm, part * model.skin_decay_mm, presses, leaning_mm, solver=solver
        )
        for part in (0.5, 1.8)
    )
    mixed = np.asarray(0.55 * near.height_mm + 0.45 * far.height_mm, np.float32)
    return replace(near, height_mm=mixed)


def turned_mm(direction: F64, sway_mm: F64) -> F64:
    """`Mechanics.lean` of a stiff tip on a soft base:
    the tip turns rigidly about O's height, above a soft ring.
    """
    angle = np.clip((direction[..., 2] - _RIM) / (0.3 * (1 - _RIM)), 0, 1)
    along = direction[..., 2:] * sway_mm
    return np.asarray(
        angle[..., None]
        * np.concatenate((along, -(direction[..., :2] @ sway_mm)[..., None]), axis=-1)
    )


def carry_far(contacts: Contacts, weight: F32, step_mm: float, model: SensorModel) -> F32:
    """`Mechanics.carry` of a contact that sticks or slides as a whole, and drags its surroundings
    with two decays: skin outside follows the contact's nearest point; the far decay is not
    exponential.
    """
    carried = np.zeros((2, *weight.shape), np.float32)
    for owner in np.unique(contacts.owner):
        mine = contacts.owner == owner
        held, mean_mm = contacts.held_mm[mine], float(contacts.pressure_mm[mine].mean())
        # One pressure for the whole contact: this model has no partial slip.
        most = min(model.coulomb * mean_mm, 0.6 * model.drag_decay_mm) / max(
            float(np.linalg.norm(held, axis=1).mean()), _LEAST_MM
        )
        beside = np.ones(weight.shape, np.uint8)
        beside[contacts.rows[mine], contacts.cols[mine]] = 0
        distance, label = cv2.distanceTransformWithLabels(
            beside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
        )
        of_label = np.zeros((label.max() + 1, 2))
        # A label is the nearest node in contact, whose displacement the skin around it follows.
        of_label[label[contacts.rows[mine], contacts.cols[mine]]] = held * min(most, 1)
        decays = distance * (step_mm / model.drag_decay_mm)
        part = 0.5 * np.exp(-2 * decays) + 0.5 / (1 + decays * decays)
        spread = cv2.blur(of_label[label], (5, 5)) * part[..., None]
        carried += np.asarray(np.moveaxis(spread, 2, 0), np.float32)
    # The weight is (1 + tan²)^-2 of half the angle from the apex.
    beyond = weight**-0.5 - 1
    rim = math.tan(math.radians(RIM_HALF_ANGLE_DEG / 2)) ** 2
    return np.asarray(
        carried * np.where(weight < CLAMPED, np.clip(1 - (beyond / rim) ** 3, 0, 1), 0), np.float32
    )


TURNING = DragMechanics(turned_mm, carry_far)
"""How objects drag the other model's skin, in which every point is an independent spring,
q = kt w.
"""
