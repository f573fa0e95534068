"""Another skin: a stiff surface over a soft depth, on a tip that turns, dragged by contacts that stick as a whole."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from tacshade_edge.simulator.drag import Contacts, Mechanics
from tacshade_edge.simulator.model import RIM_HALF_ANGLE_DEG, SensorModel
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.skin import Skin, Solver, press_skin, solve
from tacshade_edge.types import F32, F64

_RIM = math.cos(math.radians(RIM_HALF_ANGLE_DEG))


def two_scale_skin(
    model: SensorModel, presses: Sequence[Press], leaning_mm: F32 | None = None, solver: Solver = solve
) -> Skin:
    """Mix two skins into a stiff surface over a soft depth, whose skirt is not exponential."""
    near, far = (
        press_skin(model.skin_radius_mm, part * model.skin_decay_mm, presses, leaning_mm, solver=solver)
        for part in (0.5, 1.8)
    )
    mixed = np.asarray(0.55 * near.height_mm + 0.45 * far.height_mm, np.float32)
    return replace(near, height_mm=mixed)


def turned_mm(direction: F64, sway_mm: F64) -> F64:
    """`Mechanics.lean` of a stiff tip on a soft base: the tip turns rigidly about O's height, above a soft ring."""
    angle = np.clip((direction[..., 2] - _RIM) / (0.3 * (1 - _RIM)), 0, 1)
    along = direction[..., 2:] * sway_mm
    return np.asarray(angle[..., None] * np.concatenate((along, -(direction[..., :2] @ sway_mm)[..., None]), axis=-1))


def carry_far(contacts: Contacts, weight: F32, step_mm: float, model: SensorModel) -> F32:
    """`Mechanics.carry` of a contact that sticks or slides as a whole, and drags its surroundings with two decays: skin
    outside follows the contact's nearest point; the far decay is not exponential.
    """
    carried = np.zeros((2, *weight.shape), np.float32)
    for owner in np.unique(contacts.owner):
        mine = contacts.owner == owner
        held, mean_mm = contacts.held_mm[mine], float(contacts.pressure_mm[mine].mean())
        most = min(model.coulomb * mean_mm, 0.6 * model.drag_decay_mm) / max(
            float(np.linalg.norm(held, axis=1).mean()), 1e-9
        )
        beside = np.ones(weight.shape, np.uint8)
        beside[contacts.rows[mine], contacts.cols[mine]] = 0
        distance, label = cv2.distanceTransformWithLabels(beside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
        of_label = np.zeros((label.max() + 1, 2))
        of_label[label[contacts.rows[mine], contacts.cols[mine]]] = held * min(most, 1)
        decays = distance * (step_mm / model.drag_decay_mm)
        part = 0.5 * np.exp(-2 * decays) + 0.5 / (1 + decays * decays)
        spread = cv2.blur(of_label[label], (5, 5)) * part[..., None]
        carried += np.asarray(np.moveaxis(spread, 2, 0), np.float32)
    beyond = weight**-0.5 - 1  # tan² of half the angle from the apex
    rim = math.tan(math.radians(RIM_HALF_ANGLE_DEG / 2)) ** 2
    return np.asarray(carried * np.where(weight < 2, np.clip(1 - (beyond / rim) ** 3, 0, 1), 0), np.float32)


TURNING = Mechanics(turned_mm, carry_far, lambda w, *_: w)
"""How objects drag the other model's skin, in which every point is an independent spring, q = kt w."""
