"""Columns of taxels: where they are."""

from __future__ import annotations

import numpy as np

from support.calibrated_sensor import HALF
from tacshade_edge.lab.mjcf.taxels import SHELLS, taxels_of
from tacshade_edge.lab.simulator.sensor_model import flattened

PAD = flattened(HALF)
RADIUS_MM = HALF.skin_radius_mm


def test_the_second_shell_lies_on_the_skin_and_the_others_a_millimetre_apart() -> None:
    taxels = taxels_of(HALF.geometry)
    from_o = np.linalg.norm(taxels.points_mm, axis=2)
    assert np.allclose(from_o, RADIUS_MM - taxels.below_mm[:, None], atol=1e-4)
    assert taxels.below_mm.tolist() == list(range(-1, SHELLS - 1))


def test_columns_stand_below_the_cells_of_the_disc_and_of_a_ring_around_it() -> None:
    taxels = taxels_of(PAD.geometry)
    inside = np.flatnonzero(taxels.inside)
    assert set(inside) < set(taxels.cell)
    # A pad's columns go straight down, and its circle is as large as stated.
    assert np.allclose(taxels.points_mm[..., 2], -taxels.below_mm[:, None], atol=1e-6)
    radius = np.linalg.norm(taxels.points_mm[1, :, :2], axis=1)
    assert PAD.geometry.visible_radius_mm < radius.max() < PAD.geometry.visible_radius_mm + 0.6
