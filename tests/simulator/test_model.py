from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.examples import examples

from tacshade_edge.simulator.model import SensorModel, random_model


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


def test_geometry_is_the_models() -> None:
    geometry = SensorModel().geometry
    assert (geometry.skin_radius_mm, geometry.camera_distance_mm, geometry.visible_half_angle_deg) == (20.0, 14.0, 50.0)
    assert (geometry.disc.row_c, geometry.disc.col_c, geometry.disc.radius_px) == (236.4, 327.7, 205.0)


@given(st.integers(0, 2**32))
@examples(50)
def test_random_models_are_valid_inside_the_image_and_repeatable(seed: int) -> None:
    model = random_model(seed)
    assert model == random_model(seed)
    for centre, size in ((model.row_c, model.image_height_px), (model.col_c, model.image_width_px)):
        assert model.disc_radius_px <= centre <= size - 1 - model.disc_radius_px


def test_other_seeds_give_other_sensors() -> None:
    assert len({random_model(seed).pitch_mm for seed in range(10)}) == 10
