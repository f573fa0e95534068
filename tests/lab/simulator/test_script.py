from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.examples import examples
from tacshade_edge.lab.simulator.press import Press, ball
from tacshade_edge.lab.simulator.script import Drag, Script, ball_presses
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model


def test_a_turn_is_pause_approach_hold_release() -> None:
    script = Script((Press(ball(), depth_mm=4.0),), approach=3, hold=2, release=1, pause=2)
    depths = [sum(p.depth_mm for p in script.at(k)) for k in range(script.period)]
    assert depths == pytest.approx([0, 0, 1, 2, 3, 4, 4, 2])
    assert script.at(script.period + 5) == script.at(5)


def test_a_held_object_is_dragged_in_few_steps_and_lifted_in_few() -> None:
    press = Press(ball(), 1.0, 2.0, 4.0, 30.0)
    script = Script(
        (press, press), approach=3, hold=12, release=6, pause=2, drags=(Drag(3.0, -1.5, 9.0),)
    )
    held = [script.at(5 + k)[0] for k in range(12)]
    assert [p.drag_x_mm for p in held] == pytest.approx([0] * 3 + [1] * 2 + [2] * 2 + [3] * 5)
    assert [script.at(k)[0].is_dragged for k in (2, 3, 4)] == [False] * 3
    for each in held:
        part = each.drag_x_mm / 3
        assert (each.drag_y_mm, each.twist_deg, each.depth_mm) == pytest.approx(
            (-1.5 * part, 9.0 * part, 4.0)
        )
        assert each.before_drag(np.array((each.x_mm, each.y_mm))) == pytest.approx((1.0, 2.0))
        assert each.rotation_deg == pytest.approx(30.0 + each.twist_deg)
    lifted = [script.at(17 + k)[0] for k in range(6)]
    assert [p.depth_mm for p in lifted] == pytest.approx([3, 3, 2, 2, 1, 1])
    assert {p.drag_x_mm for p in lifted} == {3.0}
    assert script.at(23 + 16) == script.at(16)  # the second press, dragged as the first


def test_presses_cover_radii_depths_and_the_disc() -> None:
    drawn = ball_presses(SensorModel(), 40)
    radii, depths = [r for _, r in drawn], [p.depth_mm for p, _ in drawn]
    assert 3.0 <= min(radii) < 3.3 < 8.7 < max(radii) <= 9.0
    assert 0.5 <= min(depths) < 0.7 < 3.8 < max(depths) <= 4.0
    places = np.array([(p.x_mm, p.y_mm) for p, _ in drawn])
    away = np.linalg.norm(places, axis=1)
    assert away.max() < 20.0 * math.sin(math.radians(50.0))
    for sign_x in (-1, 1):
        for sign_y in (-1, 1):
            assert np.sum((places[:, 0] * sign_x > 0) & (places[:, 1] * sign_y > 0)) >= 8


def test_presses_are_repeatable_and_fit_every_skin() -> None:
    for seed in range(5):
        model = random_model(seed)
        one, same = ball_presses(model, 10, seed), ball_presses(model, 10, seed)
        assert [(r, p.depth_mm, p.x_mm) for p, r in one] == [
            (r, p.depth_mm, p.x_mm) for p, r in same
        ]
        assert all(p.lowest_z_mm(model.skin_radius_mm) > 0 for p, _ in one)
    assert ball_presses(SensorModel(), 0) == []


MODEL = SensorModel(sway=0.0)


@pytest.mark.parametrize(
    "change",
    [
        {"skin_radius_mm": 0.0},
        {"pitch_mm": float("nan")},
        {"skin_decay_mm": -1.0},
        {"visible_half_angle_deg": 80.0},
        {"pitch_mm": 0.01},
        {"pin_length_pitches": 9.0},
        {"light": -3.0},
        {"blur_px": float("inf")},
        {"surround": "grey"},
        {"camera_distance_mm": -14.0},
        {"friction": 1.5},
        {"creep_part": 0.2},
        {"creep_s": 0.0},
        {"image_width_px": 0},
    ],
)
def test_a_value_that_cannot_be_is_refused_by_name(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        replace(SensorModel(), **change)


@given(st.integers(0, 2**32))
@examples(50)
def test_random_models_are_valid_inside_the_image_and_repeatable(seed: int) -> None:
    model = random_model(seed)
    assert model == random_model(seed)
    for centre, size in ((model.row_c, model.image_height_px), (model.col_c, model.image_width_px)):
        assert model.disc_radius_px <= centre <= size - 1 - model.disc_radius_px
