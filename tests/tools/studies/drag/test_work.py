import math
from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import OBJECTS
from tools.studies.drag.work import CONDITIONS, DEPTHS_MM, DIRECTIONS, Condition, presses

MODEL = SensorModel()
CUBE = OBJECTS["cube"]()


def test_every_condition_is_tried_at_the_same_places() -> None:
    made = list(presses(MODEL, 5, "cube"))
    assert len(made) == len(CONDITIONS) * DIRECTIONS * len(DEPTHS_MM)
    places = [[(p.x_mm, p.y_mm, p.rotation_deg) for c, _, p in made if c == condition] for condition in CONDITIONS]
    assert all(each == places[0] for each in places)
    assert [(c, d, replace(p, shape=CUBE)) for c, d, p in made] == [
        (c, d, replace(p, shape=CUBE)) for c, d, p in presses(MODEL, 5, "cube")
    ]
    assert places[0] != [
        (p.x_mm, p.y_mm, p.rotation_deg) for c, _, p in presses(MODEL, 6, "cube") if c == CONDITIONS[0]
    ]


def test_drag_turn_and_tilt_are_as_the_condition_says() -> None:
    for condition, direction, press in presses(replace(MODEL, skin_radius_mm=30.0), 5, "ball"):
        assert math.hypot(press.drag_x_mm, press.drag_y_mm) == pytest.approx(1.5 * condition.drag_mm)
        if condition.drag_mm:
            assert math.degrees(math.atan2(press.drag_y_mm, press.drag_x_mm)) % 360 == pytest.approx(direction % 360)
        assert abs(press.twist_deg) == condition.twist_deg
        assert math.hypot(press.tilt_x_deg, press.tilt_y_deg) == pytest.approx(condition.tilt_deg)
    directions = sorted({round(d) for c, d, _ in presses(MODEL, 5, "ball")})
    assert np.diff(directions).min() > 1
    assert len(directions) == DIRECTIONS


def test_a_condition_in_words() -> None:
    assert [str(Condition()), str(Condition(2.0)), str(Condition(3.0, 10.0, 15.0))] == [
        "0 mm", "2 mm", "3 mm, twist 10°, tilt 15°",
    ]  # fmt: skip
