import math
from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.simulator.model import SensorModel
from tools.testbed.simulator.slow_light import SlowLight

IMAGE = np.full((48, 64, 3), 100, np.uint8)
MODEL = SensorModel()


def test_it_warms_up_exponentially() -> None:
    light = SlowLight(warm_up_s=100.0)
    assert light.warm_part(0.0) == 0.0
    assert light.warm_part(100.0) == pytest.approx(1 - 1 / math.e)
    assert light.warm_part(1e6) == 1.0
    assert replace(light, on_for_s=50.0).warm_part(20.0) == pytest.approx(light.warm_part(70.0))
    assert light.warm_part(-10.0) == 0.0  # not yet switched on


def test_leds_give_seventy_percent_after_their_l70() -> None:
    light = SlowLight(l70_h=1000.0)
    assert light.aged_part(0.0) == 1.0
    assert light.aged_part(1000 * 3600.0) == pytest.approx(0.7)
    assert replace(light, burnt_h=2000.0).aged_part(0.0) == pytest.approx(0.49)


def test_the_image_dims_slowly_and_starts_as_it_was() -> None:
    light = SlowLight(warm_up_s=60.0, l70_h=100.0)
    assert np.array_equal(light.on(IMAGE, MODEL, 0.0), IMAGE)
    a_frame_later = light.on(IMAGE, MODEL, 1 / 60)
    assert np.array_equal(a_frame_later, IMAGE)
    assert light.on(IMAGE, MODEL, 100 * 3600.0).max() == round((100 * 0.92 + 6) * 0.7)
