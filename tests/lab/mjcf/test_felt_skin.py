"""The skin under what the taxels feel, against the simulator's own."""

from __future__ import annotations

import math

import numpy as np
import pytest

from support.calibrated_sensor import HALF
from support.felt_objects import depths_mm, true_map
from tacshade_edge.lab.mjcf.felt_skin import FeltSkin, SkinMechanics, TouchingBody
from tacshade_edge.lab.simulator.press import OBJECTS, Press, ball
from tacshade_edge.lab.simulator.sensor_model import SensorModel, flattened
from tacshade_edge.rigid import shift, turn

BALL = Press(ball(6.0), 2.0, -1.0, 2.5)
PAD = flattened(HALF)


def body(number: int, x_mm: float, y_mm: float, turned_deg: float = 0.0) -> TouchingBody:
    at = np.array((x_mm, y_mm, 18.0))
    pose = shift(x_mm, y_mm, 24.0) @ turn((0.0, 0.0, math.radians(turned_deg)))
    return TouchingBody(number, pose, at)


def felt(mechanics: SkinMechanics, press: Press, *bodies: TouchingBody) -> FeltSkin:
    depth_mm = depths_mm(mechanics.taxels, press, mechanics.model.form_mm[0])
    skin = mechanics.feel(depth_mm, bodies, with_shear=bool(bodies))
    assert skin is not None
    return skin


@pytest.mark.parametrize("model", [HALF, PAD], ids=["dome", "pad"])
@pytest.mark.parametrize("name", ["ball", "plate"])
def test_heights_and_contact_are_those_of_the_simulator(model: SensorModel, name: str) -> None:
    press = Press(OBJECTS[name](), 2.0, -1.0, 2.5)
    mechanics = SkinMechanics(model)
    skin = felt(mechanics, press)
    true = true_map(model, mechanics.taxels, press)
    inside, touches = mechanics.taxels.inside, true.touches
    off = np.abs(skin.height_mm[inside] - true.height_mm)
    assert np.isnan(skin.height_mm[~inside]).all()
    assert float(np.median(off[touches])) < 0.1
    assert float(off.max()) < 0.3
    found = skin.contact[inside]
    assert (found & touches).sum() > 0.8 * (found | touches).sum()
    assert skin.shear_mm is None


def test_a_dragged_ball_drags_the_skin_until_it_slides() -> None:
    mechanics = SkinMechanics(HALF)
    depths = []
    for x_mm in (0.0, 0.5, 4.0):
        press = Press(ball(6.0), x_mm, 0.0, 2.5)
        skin = felt(mechanics, press, body(7, x_mm, 0.0))
        assert skin.shear_mm is not None
        depths.append(skin.shear_mm[skin.contact].mean(axis=0))
    still, held, slides = depths
    assert abs(still[0]) < 0.05
    assert 0.3 < held[0] < 0.55
    # Coulomb's law limits what 4 mm drag.
    assert held[0] < slides[0] < 3.5
    assert abs(held[1]) < 0.05


def test_a_turned_plate_twists_the_skin() -> None:
    mechanics = SkinMechanics(HALF)
    press = Press(OBJECTS["plate"](), 0.0, 0.0, 1.5)
    felt(mechanics, press, body(1, 0.0, 0.0))
    skin = felt(mechanics, press, body(1, 0.0, 0.0, 6.0))
    assert skin.shear_mm is not None
    row, col = np.nonzero(skin.contact)
    shear = skin.shear_mm[row, col]
    about_z = (col - col.mean()) * shear[:, 1] - (row - row.mean()) * shear[:, 0]
    assert (about_z > 0).mean() > 0.9


def test_a_contact_that_ended_is_forgotten() -> None:
    mechanics = SkinMechanics(HALF)
    felt(mechanics, BALL, body(7, 2.0, -1.0))
    nothing = np.zeros(mechanics.taxels.points_mm.shape[:2])
    assert mechanics.feel(nothing, (), with_shear=True) is None
    # Elsewhere, and so far away that it would slide, had it touched before.
    skin = felt(mechanics, BALL, body(7, 6.0, -1.0))
    assert skin.shear_mm is not None
    mechanics.forget()
    again = felt(mechanics, BALL, body(7, 2.0, -1.0))
    assert again.shear_mm is not None
    assert np.allclose(skin.shear_mm, again.shear_mm, equal_nan=True)


def test_each_of_two_bodies_drags_its_own_side() -> None:
    mechanics = SkinMechanics(HALF)
    press = Press(OBJECTS["two_balls"](), 0.0, 0.0, 2.5)
    felt(mechanics, press, body(1, -5.0, 0.0), body(2, 5.0, 0.0))
    moved = TouchingBody(2, shift(5.0, 0.6, 24.0), np.array((5.0, 0.6, 18.0)))
    skin = felt(mechanics, press, body(1, -5.0, 0.0), moved)
    assert skin.shear_mm is not None
    col = np.nonzero(skin.contact)[1]
    along_y = skin.shear_mm[skin.contact][:, 1]
    assert along_y[col > 28].mean() > along_y[col < 28].mean() + 0.2


def test_a_pose_without_a_body_on_the_skin_is_moved_onto_it() -> None:
    mechanics = SkinMechanics(HALF)
    at_mm = np.array((40.0, 0.0, 3.0))
    felt(mechanics, BALL, TouchingBody(1, shift(0, 0, 0), at_mm))
    skin = felt(mechanics, BALL, TouchingBody(1, shift(0.5, 0, 0), at_mm))
    assert skin.shear_mm is not None
    assert np.isfinite(skin.shear_mm[mechanics.taxels.inside]).all()
