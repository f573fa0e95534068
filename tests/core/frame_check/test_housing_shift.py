import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.calibrated_sensor import FULL, HALF, simulated

from tacshade_edge.core.frame_check.housing_shift import CELL_PX, HousingShift
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.simulator import nuisance
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.types import U8, Disc

PRESS = Press(OBJECTS["cube"](), 3.0, 2.0, 4.0, 10.0)
LEANING = replace(HALF, sway=0.6, coulomb=50.0)


def housing(model: SensorModel) -> HousingShift:
    return HousingShift(to_grey(simulated(model).frame((), 1).image), model.geometry.disc, CELL_PX)


@pytest.mark.parametrize("model", [HALF, FULL])
@pytest.mark.parametrize("shift", [(0, 2), (-3, 3), (5, 0), (-4, -5)])
def test_a_shift_is_measured_also_under_a_contact(model: SensorModel, shift: tuple[int, int]) -> None:
    measured = housing(model)
    assert measured.tells
    for presses in ((), (PRESS,)):
        image = nuisance.shift(simulated(model).frame(presses, 2).image, *shift)
        assert measured.measure_px(to_grey(image)) == pytest.approx(math.hypot(*shift), rel=0.25)


@pytest.mark.parametrize(
    "drag",
    [{"drag_x_mm": 4.0}, {"drag_y_mm": -4.0}, {"drag_x_mm": -3.0, "drag_y_mm": 3.0, "twist_deg": 15.0}],
    ids=str,
)
def test_skin_that_is_dragged_is_no_move(drag: dict[str, float]) -> None:
    frame = simulated(LEANING).frame((replace(PRESS, **drag),), 3)
    assert housing(LEANING).measure_px(to_grey(frame.image)) < 0.3


@pytest.mark.parametrize(
    "change",
    [
        lambda image: nuisance.gain(image, 0.8),
        lambda image: nuisance.gain(image, 1.2),
        lambda image: nuisance.uneven(image, HALF.row_c, HALF.col_c, HALF.disc_radius_px, 0.3, 200.0),
        lambda image: nuisance.warm(image, HALF.row_c, HALF.col_c, 1.0),
        lambda image: nuisance.noise(image, 8.0, 1),
        lambda image: nuisance.glare(image, 20.0, 60.0, 8.0),
    ],
    ids=["darker", "brighter", "an aged LED", "warm", "noise", "a lamp beside the disc"],
)
def test_other_light_noise_and_warmth_are_no_move(change: Callable[[U8], U8]) -> None:
    image = change(simulated(HALF).frame((), 4).image)
    assert housing(HALF).measure_px(to_grey(image)) < 0.5


def test_what_is_dark_or_not_in_the_image_tells_nothing() -> None:
    assert not housing(replace(HALF, surround="dark")).tells
    image = to_grey(simulated(HALF).frame((), 1).image)
    assert not HousingShift(image, Disc(120.0, 160.0, 400.0), CELL_PX).tells
    assert not HousingShift(np.zeros((5, 3), np.uint8), Disc(2.0, 1.0, 1.0), CELL_PX).tells


def test_a_black_frame_is_measured_without_a_fault() -> None:
    assert math.isfinite(housing(HALF).measure_px(np.zeros((HALF.image_height_px, HALF.image_width_px), np.uint8)))
