"""How far objects reach in, by what columns of taxels feel."""

from __future__ import annotations

import numpy as np
import pytest

from support.calibrated_sensor import HALF
from support.felt_objects import depths_mm
from tacshade_edge.lab.mjcf.reach import reached_mm
from tacshade_edge.lab.mjcf.taxels import taxels_of
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball
from tacshade_edge.lab.simulator.sensor_model import flattened

PAD = flattened(HALF)
RADIUS_MM = HALF.skin_radius_mm


def test_a_ball_reaches_as_far_as_its_surface_along_each_column() -> None:
    taxels = taxels_of(HALF.geometry)
    press = Press(ball(6.0), 3.0, -2.0, 3.0)
    least, _ = reached_mm(taxels, depths_mm(taxels, press, RADIUS_MM))
    centre = np.array((3.0, -2.0, press.lowest_z_mm(RADIUS_MM) + 6.0))
    direction = taxels.points_mm[1] / np.linalg.norm(taxels.points_mm[1], axis=1, keepdims=True)
    along = direction @ centre
    under = along**2 - centre @ centre + 36.0
    true = np.where(under > 0, RADIUS_MM - (along - np.sqrt(np.maximum(under, 0))), 0)
    low = least.ravel()[taxels.cell]
    reached = true > 0
    assert true.max() > 2.9
    assert np.abs(low - true)[reached].max() < 0.3  # where a ray grazes the ball
    assert float(np.median(np.abs(low - true)[reached])) < 0.02
    assert not low[~reached].any()


def test_beside_a_wall_the_true_reach_lies_between_the_least_and_the_greatest() -> None:
    taxels = taxels_of(PAD.geometry)
    press = Press(OBJECTS["cylinder"](), 0.2, 0.1, 2.8)
    least, greatest = reached_mm(taxels, depths_mm(taxels, press, PAD.form_mm[0]))
    x, y, _ = taxels.points_mm[1].T
    face = np.hypot(x - 0.2, y - 0.1) < 4.7  # its edge is rounded
    low, high = (each.ravel()[taxels.cell][face] for each in (least, greatest))
    assert (low < 2.8 + 0.05).all()
    assert (high > 2.8 - 0.05).all()
    assert (high > low).any()
    middle = (np.hypot(x - 0.2, y - 0.1) < 2.0)[face]
    assert np.allclose(low[middle], 2.8, atol=0.01)


@pytest.mark.parametrize("shell", [None, 0])
def test_what_only_the_shell_outside_feels_does_not_touch(shell: int | None) -> None:
    taxels = taxels_of(HALF.geometry)
    depth_mm = np.zeros(taxels.points_mm.shape[:2])
    if shell is not None:
        depth_mm[shell] = 0.4
    least, greatest = reached_mm(taxels, depth_mm)
    assert not least.any()
    assert not greatest.any()
