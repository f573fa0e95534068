"""The membrane that begins with its last solution, against the one that begins with none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.calibrated_sensor import HALF
from tacshade_edge.lab.mjcf.near_membrane import NearMembrane
from tacshade_edge.lab.simulator.drag import Contacts, carry
from tacshade_edge.lab.simulator.skin import mass_weight_of, skin_over, undeformed
from tacshade_edge.types import F32

STEPS = 32
FLAT = undeformed(*HALF.form_mm, STEPS)
WEIGHT = mass_weight_of(FLAT)[::2, ::2]


def pressed(x_steps: int, depth_mm: float = 2.5) -> F32:
    """A paraboloid's reach into the skin."""
    n = len(FLAT.height_mm) // 2
    row, col = np.mgrid[-n : n + 1, -n : n + 1].astype(np.float32)
    reach = depth_mm - 0.03 * (row**2 + (col - x_steps) ** 2)
    return np.asarray(np.maximum(reach, 0), np.float32)


def contacts(held_mm: float, pressure_mm: float) -> Contacts:
    rows, cols = (each.ravel() + 20 for each in np.mgrid[:6, :6])
    held = np.tile((held_mm, 0.0), (36, 1))
    return Contacts(
        rows, cols, np.zeros(36, np.int64), held, np.zeros((36, 2)), np.full(36, pressure_mm)
    )


def test_every_shape_is_the_one_found_from_nothing() -> None:
    membrane = NearMembrane(FLAT, HALF.skin_decay_mm)
    # Small steps, a jump, and shallower.
    for x_steps, depth_mm in ((0, 2.5), (1, 2.5), (2, 2.4), (-15, 3.0), (-15, 0.5)):
        obstacle = pressed(x_steps, depth_mm)
        alone = skin_over(FLAT, obstacle, HALF.skin_decay_mm)
        made = membrane.over(obstacle)
        assert np.abs(made.height_mm - alone.height_mm).max() < 2e-3
        assert made.obstacle_mm is obstacle


def test_every_drag_is_the_one_found_from_nothing() -> None:
    membrane, step_mm = NearMembrane(FLAT, HALF.skin_decay_mm), 2 * FLAT.step_mm
    for held_mm, pressure_mm in ((0.5, 9.0), (0.6, 9.0), (2.0, 0.3), (-1.0, 0.3), (0.0, 0.3)):
        given = contacts(held_mm, pressure_mm)
        alone = carry(given, WEIGHT, step_mm, HALF)
        found = membrane.carry(given, WEIGHT, step_mm, HALF)
        assert np.abs(found - alone).max() < 0.02


def test_a_sliding_contact_sways_the_dome_by_the_same_part_as_before() -> None:
    membrane, step_mm = NearMembrane(FLAT, HALF.skin_decay_mm), 2 * FLAT.step_mm
    asked = np.array((0.5, 0.0))
    assert membrane.assume(asked).tolist() == [0.5, 0.0]
    membrane.carry(contacts(2.0, 0.3), WEIGHT, step_mm, HALF)
    part = membrane.assume(asked)[0] / 0.5
    assert 0.05 < part < 0.9
    assert membrane.assume(2 * asked)[0] == pytest.approx(part)
    membrane.forget()
    assert membrane.assume(asked).tolist() == [0.5, 0.0]


def test_contacts_that_pull_a_dome_that_nothing_sways_ask_for_the_whole() -> None:
    membrane = NearMembrane(FLAT, HALF.skin_decay_mm)
    membrane.assume(np.zeros(2))
    membrane.carry(contacts(2.0, 9.0), WEIGHT, 2 * FLAT.step_mm, replace(HALF, sway=0.5))
    assert membrane.assume(np.ones(2)).tolist() == [1.0, 1.0]
