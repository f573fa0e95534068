"""The skin's membrane from one step to the next: each solution begins with the last. Pure.

Between two steps of a simulation, a skin hardly changes: a few sweeps of the finest grid find it,
and a dome whose contact slides yields about as much as before.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from tacshade_edge.lab.simulator.drag import SWAY_TOLERANCE_MM, Contacts, carry
from tacshade_edge.lab.simulator.membrane import slid, solve
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import Skin, mass_weight_of
from tacshade_edge.types import F32, F64


class NearMembrane:
    """Solves the problems of `membrane` over an undeformed skin, and remembers the solutions."""

    def __init__(self, flat: Skin, decay_mm: float) -> None:
        self._flat = flat
        self._mass = mass_weight_of(flat) * np.float32((flat.step_mm / decay_mm) ** 2)
        self.forget()

    def forget(self) -> None:
        """Begin anew: what comes next is not near."""
        self._height_mm: F32 | None = None
        self._carried_mm: F32 | None = None
        self._stuck_mm = np.zeros(2)
        self._part = 1.0

    def over(self, obstacle: F32) -> Skin:
        """The skin's shape over an obstacle, as `skin.skin_over` finds it."""
        self._height_mm = solve(obstacle, self._mass, self._height_mm)
        return replace(self._flat, height_mm=self._height_mm, obstacle_mm=obstacle)

    def assume(self, stuck_mm: F64) -> F64:
        """The dome's sway, (2,) mm, from that of a contact that sticks: the same part as before."""
        self._stuck_mm = stuck_mm
        return stuck_mm * self._part

    def carry(self, contacts: Contacts, weight: F32, step_mm: float, model: SensorModel) -> F32:
        """How contacts drag the skin along itself, as `drag.carry`."""
        solver = partial(slid, near=self._carried_mm)
        self._carried_mm = carry(contacts, weight, step_mm, model, solver)
        if len(contacts.rows):
            at_contacts = self._carried_mm[:, contacts.rows, contacts.cols]
            self._part = self._part_of(at_contacts.mean(axis=1) * (model.sway / (1 - model.sway)))
        return self._carried_mm

    def _part_of(self, sway_mm: F64) -> float:
        """The part of the sway of a contact that sticks, 1 unless it slides."""
        stuck_mm = float(np.linalg.norm(self._stuck_mm))
        if np.abs(sway_mm - self._stuck_mm).max() <= SWAY_TOLERANCE_MM or not stuck_mm:
            return 1.0
        return min(1.0, float(np.linalg.norm(sway_mm)) / stuck_mm)
