"""Sensors of another model, never trained on: square lattice, mushroom pins, other skin, other mechanics of drag."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from tacshade_edge.simulator.drag import Contacts, Mechanics, drag_skin
from tacshade_edge.simulator.model import RIM_HALF_ANGLE_DEG, SensorModel, random_model
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedFrame
from tacshade_edge.simulator.skin import Skin, press_skin
from tacshade_edge.types import F32, F64, U8
from tools.testbed.simulator.left_over import left_over
from tools.testbed.simulator.varied_print import PinProfile, VariedRenderer, lattice_print

CAPS = PinProfile(((1.0, 0.7, 0.0),))
"""A tapering stem under a flat cap."""


FRUSTUM = PinProfile(())

_RIM = math.cos(math.radians(RIM_HALF_ANGLE_DEG))


class OtherSensor:
    """A `SimulatedSensor` of the other model, or of the usual model with some of the other's features.

    Parameters
    ----------
    model : SensorModel
    square, capped, two_scales : bool
        Whether the lattice, the pins and the skin are the other model's.
    """

    def __init__(self, model: SensorModel, square: bool = True, capped: bool = True, two_scales: bool = True) -> None:
        self.model = model
        self._differences = (square, capped, two_scales)
        marks = lattice_print(model, 90.0) if square else None
        self._renderer = VariedRenderer(model, marks, CAPS if capped else FRUSTUM)
        self._drawn: tuple[Skin, F32] | None = None

    def noiseless(self) -> OtherSensor:
        """Make the same sensor with a noiseless camera."""
        return OtherSensor(replace(self.model, read_noise_grey=0.0, shot_noise_grey=0.0), *self._differences)

    def frame(self, presses: Sequence[Press] = (), noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture."""
        skin = self.skin(presses)
        return SimulatedFrame(self.picture(skin, noise_seed), tuple(presses), skin, self.model)

    def released(self, presses: Sequence[Press], part: float, noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture after a release, while the skin still keeps part of its deformation."""
        skin = left_over(self.skin(presses), part)
        return SimulatedFrame(self.picture(skin, noise_seed), (), skin, self.model)

    def picture(self, skin: Skin, noise_seed: int = 0) -> U8:
        """Take a picture of a skin: uint8 (H, W, 3) BGR."""
        if self._drawn is None or self._drawn[0] is not skin:
            self._drawn = skin, self._renderer.draw(skin)
        return self._renderer.expose(self._drawn[1], noise_seed)

    def skin(self, presses: Sequence[Press] = ()) -> Skin:
        """Compute the skin under the presses."""
        model, presses = self.model, tuple(presses)

        def shape(leaning_mm: F32 | None) -> Skin:
            if self._differences[2]:
                return two_scale_skin(model, presses, leaning_mm)
            return press_skin(model.skin_radius_mm, model.skin_decay_mm, presses, leaning_mm)

        return drag_skin(shape, model, presses, TURNING if self._differences[2] else None)


def turned_mm(direction: F64, sway_mm: F64) -> F64:
    """`Mechanics.lean` of a stiff tip on a soft base: the tip turns rigidly about O's height, above a soft ring."""
    angle = np.clip((direction[..., 2] - _RIM) / (0.3 * (1 - _RIM)), 0, 1)
    along = direction[..., 2:] * sway_mm
    return np.asarray(angle[..., None] * np.concatenate((along, -(direction[..., :2] @ sway_mm)[..., None]), axis=-1))


def carry_far(contacts: Contacts, weight: F32, step_mm: float, model: SensorModel) -> F32:
    """`Mechanics.carry` of a contact that sticks or slides as a whole, and drags its surroundings with two decays.

    Skin outside a contact follows the contact's nearest point; the far decay is not exponential.
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


def other_model(seed: int) -> SensorModel:
    """Draw a sensor with caps so wide that contact makes the image brighter."""
    rng = np.random.default_rng((seed, 13))
    return replace(
        random_model(seed),
        pin_tip_radius_pitches=float(rng.uniform(0.36, 0.40)),
        pin_base_radius_pitches=float(rng.uniform(0.18, 0.24)),
        marker_radius_pitches=float(rng.uniform(0.40, 0.50)),
    )


def two_scale_skin(model: SensorModel, presses: Sequence[Press], leaning_mm: F32 | None = None) -> Skin:
    """Mix two skins into a stiff surface over a soft depth, whose skirt is not exponential."""
    near = press_skin(model.skin_radius_mm, 0.5 * model.skin_decay_mm, presses, leaning_mm)
    far = press_skin(model.skin_radius_mm, 1.8 * model.skin_decay_mm, presses, leaning_mm)
    mixed = np.asarray(0.55 * near.height_mm + 0.45 * far.height_mm, np.float32)
    return replace(near, height_mm=mixed)
