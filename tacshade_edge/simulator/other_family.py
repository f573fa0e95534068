"""Sensors of another model, never trained on: square lattice, mushroom pins, a skin with two decay lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedFrame
from tacshade_edge.simulator.skin import Skin, left_over, press_skin
from tacshade_edge.simulator.varied_print import PinProfile, VariedRenderer, lattice_print

CAPS = PinProfile(((1.0, 0.7, 0.0),))
"""A stem that tapers, under a flat cap."""


FRUSTUM = PinProfile(())


class OtherSensor:
    """As `SimulatedSensor`, of the other model; or of the usual one with some of its differences.

    Parameters
    ----------
    model : SensorModel
    square, capped, two_scales : bool
        Whether the lattice, the pins, the skin are the other model's.
    """

    def __init__(self, model: SensorModel, square: bool = True, capped: bool = True, two_scales: bool = True) -> None:
        self.model = model
        self._differences = (square, capped, two_scales)
        marks = lattice_print(model, 90.0) if square else None
        self._renderer = VariedRenderer(model, marks, CAPS if capped else FRUSTUM)

    def noiseless(self) -> OtherSensor:
        """As `SimulatedSensor.noiseless`."""
        return OtherSensor(replace(self.model, read_noise_grey=0.0, shot_noise_grey=0.0), *self._differences)

    def frame(self, presses: Sequence[Press] = (), noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture."""
        skin = self._pressed(presses)
        return SimulatedFrame(
            self._renderer.expose(self._renderer.draw(skin), noise_seed), tuple(presses), skin, self.model
        )

    def released(self, presses: Sequence[Press], part: float, noise_seed: int = 0) -> SimulatedFrame:
        """As `SimulatedSensor.released`."""
        skin = left_over(self._pressed(presses), part)
        return SimulatedFrame(self._renderer.expose(self._renderer.draw(skin), noise_seed), (), skin, self.model)

    def _pressed(self, presses: Sequence[Press]) -> Skin:
        if self._differences[2]:
            return two_scale_skin(self.model, tuple(presses))
        return press_skin(self.model.skin_radius_mm, self.model.skin_decay_mm, tuple(presses))


def other_model(seed: int) -> SensorModel:
    """Draw a sensor; its caps are wide, so that contact brightens it."""
    rng = np.random.default_rng((seed, 13))
    return replace(
        random_model(seed),
        pin_tip_radius_pitches=float(rng.uniform(0.36, 0.40)),
        pin_base_radius_pitches=float(rng.uniform(0.18, 0.24)),
        marker_radius_pitches=float(rng.uniform(0.40, 0.50)),
    )


def two_scale_skin(model: SensorModel, presses: Sequence[Press]) -> Skin:
    """The mean of two skins: a stiff surface over a soft depth, whose skirt is no exponential."""
    near = press_skin(model.skin_radius_mm, 0.5 * model.skin_decay_mm, presses)
    far = press_skin(model.skin_radius_mm, 1.8 * model.skin_decay_mm, presses)
    mixed = np.asarray(0.55 * near.height_mm + 0.45 * far.height_mm, np.float32)
    return Skin(near.radius_mm, near.step_mm, mixed, near.obstacle_mm)
