"""Pictures that are refused, and pass when they are turned back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.calibrated_sensor import HALF, TACTIP, pressed, references, unloaded
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.frame_check.turned import likelier_turn, with_turn
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.types import U8

REFUSED = Reason(ReasonCode.SURROUND, "moved")
SIZES = st.tuples(st.integers(2, 9), st.integers(2, 9))


def turned(image: U8, quarters: int, *, mirrored: bool) -> U8:
    made = np.rot90(image, quarters)
    return np.ascontiguousarray(np.fliplr(made) if mirrored else made)


@settings(max_examples=200, deadline=None)
@given(SIZES, st.integers(0, 3), st.booleans())
def test_any_way_of_turning_a_picture_is_named_once_it_is_undone(
    size: tuple[int, int], quarters: int, mirrored: bool
) -> None:
    image = np.arange(size[0] * size[1], dtype=np.uint8).reshape(size)
    made = turned(image, quarters, mirrored=mirrored)
    said = with_turn(REFUSED, made, size, lambda tried: np.array_equal(tried, image))
    assert said.code is REFUSED.code
    if quarters == 0 and not mirrored:
        assert said == REFUSED
    else:
        assert said.text.startswith("moved; it passes ")
        assert said.text.endswith(": has the camera or a program done that?")


@settings(max_examples=50, deadline=None)
@given(SIZES)
def test_a_picture_of_something_else_is_no_turned_one(size: tuple[int, int]) -> None:
    image = np.zeros(size, np.uint8)
    tried = list[tuple[int, ...]]()

    def passes(image: U8) -> bool:
        tried.append(image.shape)
        return False

    assert with_turn(REFUSED, image, size, passes) == REFUSED
    assert set(tried) == {size}


SENSORS = (HALF, TACTIP)


@pytest.mark.parametrize("model", SENSORS)
@pytest.mark.parametrize("depth_mm", [0.0, 4.0])
def test_a_picture_fits_the_reference_in_one_way(model: SensorModel, depth_mm: float) -> None:
    reference = to_grey(references(model)[0])
    image = unloaded(model) if not depth_mm else pressed("ball", depth_mm, model, 4.0, -3.0).image
    assert likelier_turn(to_grey(image), reference) == ""
    for name, undo in (
        ("mirrored left to right", np.fliplr),
        ("mirrored top to bottom", np.flipud),
        ("turned by 180 degrees", lambda grey: np.rot90(grey, 2)),
    ):
        assert likelier_turn(np.ascontiguousarray(undo(to_grey(image))), reference) == name


def test_what_shows_nothing_of_the_reference_is_not_turned() -> None:
    reference = to_grey(references()[0])
    noise = np.random.default_rng(0).integers(0, 256, reference.shape, np.uint8)
    for grey in (noise, np.zeros_like(reference), np.roll(reference, 9, axis=1), reference[:-2]):
        assert likelier_turn(np.ascontiguousarray(grey), reference) == ""
