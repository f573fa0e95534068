import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import OBJECTS, Shape, ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.types import Slip
from tools.testbed.simulator.motion import Motion, pressed
from tools.testbed.simulator.moving_scene import MovingScene
from tools.testbed.simulator.slow_light import SlowLight

pytestmark = pytest.mark.slow

SMALL = replace(SensorModel(), image_height_px=120, image_width_px=160, row_c=58.7, col_c=82.3, disc_radius_px=51.0)
PRESS = Press(ball(5.0), 0.0, 0.0, 3.0)
DOWN = pressed(PRESS, 1.0, 20.0)


def middle_mm(scene: MovingScene, t_s: float) -> float:
    grid = scene.skin(t_s).height_mm
    return float(grid[len(grid) // 2, len(grid) // 2])


def test_without_creep_every_frame_is_that_of_a_static_press() -> None:
    model = replace(SMALL, creep_part=0.0)
    scene = MovingScene([DOWN.held(2.0).released(20.0)], model)
    sensor = SimulatedSensor(model)
    for t_s, presses in ((0.5, ()), (2.0, (PRESS,)), (9.0, ())):
        assert np.array_equal(scene.frame(t_s, 7).image, sensor.frame(presses, 7).image)


def test_a_held_object_sinks_in_and_leaves_a_dent_that_recovers() -> None:
    model = replace(SMALL, creep_part=0.1, creep_s=0.7)
    scene = MovingScene([DOWN.held(60.0).released(1000.0)], model)
    begin_s, end_s = scene.motions[0].times_s[2], scene.motions[0].times_s[3]
    assert middle_mm(scene, begin_s) == pytest.approx(3.0 + 0.1 * 3.0 * 0.1, abs=0.02)  # it takes 0.15 s to come down
    for after_s in (0.5, 1.0, 2.0, 30.0):
        grown = 3.0 * (1 + 0.1 * (1 - math.exp(-(after_s + 0.075) / 0.7)))
        assert middle_mm(scene, begin_s + after_s) == pytest.approx(grown, abs=0.005)
    for after_s in (0.1, 0.7, 2.0):
        assert middle_mm(scene, end_s + after_s) == pytest.approx(0.3 * math.exp(-after_s / 0.7), abs=0.005)
        assert scene.presses(end_s + after_s) == ()
    assert middle_mm(scene, end_s + 0.01) < 0.1 * middle_mm(scene, end_s)
    assert middle_mm(scene, end_s + 20.0) == 0.0


def test_the_object_touches_the_skin_that_crept() -> None:
    scene = MovingScene([DOWN.held(5.0).released(20.0)], SMALL)
    truth = scene.frame(5.0).truth()
    assert truth.contact.sum() > 100
    assert truth.depth_max_mm == pytest.approx(3.0 * (1 + SMALL.creep_part), abs=0.02)
    dent = scene.frame(7.0).truth()
    assert dent.depth_max_mm > 0.02
    assert not dent.contact.any()


def test_a_skin_that_crept_to_its_end_is_drawn_once() -> None:
    scene = MovingScene([DOWN.held(60.0)], SMALL)
    assert scene.skin(30.0) is scene.skin(50.0)
    one, again, other = scene.frame(30.0, 1), scene.frame(50.0, 1), scene.frame(50.0, 2)
    assert np.array_equal(one.image, again.image)
    assert not np.array_equal(again.image, other.image)


@pytest.mark.parametrize(("shape", "speed_mm_s"), [(ball(5.0), 5.0), (ball(5.0), 40.0), (OBJECTS["cylinder"](), 20.0)])
def test_a_contact_sticks_then_slides_in_part_then_as_a_whole_at_the_object_s_speed(
    shape: Shape, speed_mm_s: float
) -> None:
    press = replace(PRESS, shape=shape, x_mm=-3.0)
    motion = pressed(press, 0.0, 20.0).held(0.5).dragged(7.0, 0.0, speed_mm_s).held(1.0)
    scene = MovingScene([motion], SMALL)
    begin_s = motion.times_s[3]
    states = [scene.objects(begin_s + d / speed_mm_s)[0] for d in (-1.0, 0.3, 2.0, 5.0, 6.0)]
    assert [s.slip for s in states] == [Slip.STICK, Slip.STICK, Slip.PARTIAL, Slip.FULL, Slip.FULL]
    stuck = [s.stuck for s in states]
    assert stuck == sorted(stuck, reverse=True)
    assert states[0].slip_mm_s == 0.0
    assert states[1].slip_mm_s < 0.05 * speed_mm_s
    for state in states[3:]:
        assert state.slip_mm_s == pytest.approx(speed_mm_s, rel=0.2)
        assert state.velocity_mm_s[0] == pytest.approx(speed_mm_s)
    (rests,) = scene.objects(motion.times_s[4] + 0.5)
    assert rests.slip_mm_s < 0.2
    assert rests.velocity_mm_s == (0, 0, 0)


def test_of_two_objects_each_has_its_own_state() -> None:
    one = pressed(replace(PRESS, shape=ball(3.0), x_mm=-6.0, depth_mm=2.5), 0.0, 20.0).held(0.5)
    other = pressed(replace(PRESS, shape=ball(3.0), x_mm=6.0, depth_mm=2.5), 0.0, 20.0).held(0.5)
    scene = MovingScene([one.dragged(0.0, 8.0, 10.0), other.held(0.9).twisted(5.0, 10.0).released(20.0)], SMALL)
    t_s = one.times_s[-1] + 0.7
    slides, stays = scene.objects(t_s)
    assert (slides.slip, stays.slip) == (Slip.FULL, Slip.STICK)
    assert slides.press is not None
    assert slides.press.drag_y_mm == pytest.approx(7.0)
    assert slides.slip_mm_s == pytest.approx(10.0, rel=0.2)
    assert stays.slip_mm_s < 1.0
    gone, turns = scene.objects(t_s + 0.4)
    assert (gone.press, gone.touches, gone.slip) == (None, False, None)
    assert turns.turn_deg_s == pytest.approx(10.0)


def test_light_changes_slowly() -> None:
    scene = MovingScene([DOWN], SMALL, SlowLight(warm_up_s=10.0))
    cold, warm = (MovingScene([DOWN], SMALL).frame(0.0, 1).image, scene.frame(0.0, 1).image)
    assert np.array_equal(cold, warm)
    hot = scene.frame(0.9, 1).image.mean()
    assert hot < cold.mean()


@settings(deadline=None, max_examples=6)
@given(
    depth_mm=st.floats(0.2, 4.0),
    drag_mm=st.floats(0.1, 8.0),
    twist_deg=st.floats(1.0, 30.0),
    part=st.floats(0, 1 / 9),
    t_s=st.floats(-1.0, 5.0),
)
def test_any_time_has_a_finite_skin_and_frame(
    depth_mm: float, drag_mm: float, twist_deg: float, part: float, t_s: float
) -> None:
    motion: Motion = pressed(replace(PRESS, depth_mm=depth_mm), 0.0, 20.0).held(0.3).dragged(-drag_mm, 0.0, 10.0)
    motion = motion.twisted(twist_deg, 60.0).released(20.0)
    scene = MovingScene([motion], replace(SMALL, creep_part=part))
    frame = scene.frame(t_s)
    assert np.isfinite(frame.skin.height_mm).all()
    assert frame.truth().depth_max_mm <= 1.2 * depth_mm + 0.5
