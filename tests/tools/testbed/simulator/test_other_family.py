import math
from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.simulator.skin import press_skin
from tools.testbed.simulator.other_family import OtherSensor, other_model, turned_mm, two_scale_skin
from tools.testbed.simulator.varied_print import PinProfile, VariedRenderer, lattice_print

MODEL = replace(other_model(3), image_height_px=240, image_width_px=320, row_c=119.0, col_c=160.0, disc_radius_px=100.0)
PRESS = Press(ball(6.0), 1.0, 1.0, 3.0)


@pytest.fixture(scope="module")
def sensor() -> OtherSensor:
    return OtherSensor(MODEL)


def test_the_same_seed_gives_the_same_sensor_and_frame(sensor: OtherSensor) -> None:
    assert other_model(3) == other_model(3) != other_model(4)
    one = sensor.frame((PRESS,), 5).image
    np.testing.assert_array_equal(one, OtherSensor(MODEL).frame((PRESS,), 5).image)


def test_contact_brightens_it(sensor: OtherSensor) -> None:
    frame = sensor.frame((PRESS,), 1)
    change = to_grey(frame.image).astype(int) - to_grey(sensor.frame((), 2).image)
    contact = frame.truth().contact
    assert np.count_nonzero(contact) > 300
    assert change[contact].mean() > 10


def test_the_skin_of_two_scales_stays_outside_the_object_and_is_no_single_one() -> None:
    skin = two_scale_skin(MODEL, (PRESS,))
    assert (skin.height_mm >= skin.obstacle_mm - 1e-3).all()
    for decay in np.linspace(0.5, 1.8, 8):
        single = press_skin(MODEL.skin_radius_mm, decay * MODEL.skin_decay_mm, (PRESS,)).height_mm
        assert np.abs(single - skin.height_mm).max() > 0.05


def test_the_lattice_is_square_with_a_marker_in_each_cell() -> None:
    exact = replace(MODEL, position_tolerance_mm=0.0, size_tolerance=0.0)
    marks = lattice_print(exact, 90.0)
    pins, markers = marks.pin_chart_mm, marks.marker_chart_mm.mean(axis=1)
    middle = pins[np.argmin(np.linalg.norm(pins, axis=1))]
    near = np.sort(np.linalg.norm(pins - middle, axis=1))[1:9]
    assert near[:4] == pytest.approx(exact.pitch_mm, rel=0.03)
    assert near[4:] == pytest.approx(exact.pitch_mm * np.sqrt(2), rel=0.03)
    beside = np.sort(np.linalg.norm(markers - middle, axis=1))[:4]
    assert beside == pytest.approx(exact.pitch_mm / np.sqrt(2), rel=0.03)


def test_a_waist_shows_less_black_than_a_belly() -> None:
    skin = press_skin(MODEL.skin_radius_mm, MODEL.skin_decay_mm, ())
    black = [
        np.count_nonzero(VariedRenderer(MODEL, None, PinProfile.waist(0.5, part)).draw(skin) < 60)
        for part in (0.6, 1.0, 1.4)
    ]
    assert black[0] < black[1] < black[2]


def test_a_released_skin_keeps_a_part_of_its_own_dent(sensor: OtherSensor) -> None:
    pressed, left = sensor.frame((PRESS,), 5), sensor.released((PRESS,), 0.05, 5)
    np.testing.assert_allclose(left.skin.height_mm, 0.05 * pressed.skin.height_mm, atol=1e-6)
    assert left.presses == ()
    assert not np.array_equal(left.image, sensor.frame((), 5).image)


def test_each_difference_can_stand_alone() -> None:
    usual = SimulatedSensor(MODEL).frame((PRESS,), 5).image
    none = OtherSensor(MODEL, square=False, capped=False, two_scales=False)
    np.testing.assert_array_equal(none.frame((PRESS,), 5).image, usual)
    alone = [
        OtherSensor(MODEL, *(k == j for k in range(3))).frame((PRESS,), 5).image.astype(int) - usual for j in range(3)
    ]
    assert all(np.abs(difference).max() > 50 for difference in alone)


def test_without_noise_two_exposures_are_one(sensor: OtherSensor) -> None:
    quiet = sensor.noiseless()
    np.testing.assert_array_equal(quiet.frame((PRESS,), 5).image, quiet.frame((PRESS,), 6).image)
    off = quiet.frame((PRESS,), 5).image.astype(int) - sensor.frame((PRESS,), 5).image
    assert 0 < np.abs(off).mean() < 5


def test_its_skin_is_dragged_in_another_way(sensor: OtherSensor) -> None:
    press = replace(PRESS, drag_x_mm=1.5)
    frame = sensor.frame((press,), 5)
    here = frame.truth().contact.nonzero()
    in_contact = frame.shear_mm(here[0].astype(float), here[1].astype(float))
    assert np.median(in_contact[:, 0]) == pytest.approx(1.5, abs=0.15)
    beside = np.array([MODEL.row_c]), np.array([MODEL.col_c - 70])
    usual = OtherSensor(MODEL, two_scales=False).frame((press,), 5)
    assert frame.shear_mm(*beside)[0, 0] - usual.shear_mm(*beside)[0, 0] > 0.05  # it reaches further
    direction = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, math.sqrt(0.75)]])
    turned = turned_mm(direction, np.array([1.0, 0.0]))
    np.testing.assert_allclose(turned[0], (1.0, 0.0, 0.0))
    assert np.abs(np.sum(turned * direction, axis=1)).max() < 1e-12, "a turn about O moves no skin inwards"
