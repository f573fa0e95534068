"""The signs and the order of rotations are those of PRESSES.csv and of a touch without labels."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tacshade_edge.capture.labels.robot_labels import labels_between
from tacshade_edge.rigid import Rigid, shift, turn

R_MM = 20.0
TIP = shift(0, 0, R_MM)
FIRST = shift(300, -20, 150) @ turn((2.0, 0.3, 0.1))


def labels(now_T_object: Rigid) -> dict[str, float]:
    """Of an object whose own frame was at the tip at first touch, and is there now."""
    return labels_between(FIRST, FIRST @ TIP @ now_T_object.inverse(), R_MM)


def expected(**values: float) -> dict[str, float]:
    names = ("depth_mm", "tilt_x_deg", "tilt_y_deg", "shear_x_mm", "shear_y_mm", "twist_deg")
    return {name: pytest.approx(values.get(name, 0.0), abs=1e-9) for name in names}


def test_a_sensor_that_goes_down_and_aside_drags_the_object_the_other_way() -> None:
    assert labels_between(FIRST, FIRST, R_MM) == expected()
    assert labels_between(FIRST, FIRST @ shift(0.5, -0.25, 1.5), R_MM) == expected(
        depth_mm=1.5, shear_x_mm=-0.5, shear_y_mm=0.25
    )


def test_a_sensor_that_turns_about_its_tip_is_neither_deeper_nor_sheared() -> None:
    for axis in ((0.2, 0, 0), (0, -0.3, 0), (0, 0, 0.4)):
        found = labels_between(FIRST, FIRST @ TIP @ turn(axis) @ TIP.inverse(), R_MM)
        assert (found["depth_mm"], found["shear_x_mm"], found["shear_y_mm"]) == pytest.approx((0, 0, 0), abs=1e-9)


def test_twist_then_tilt_about_x_then_about_y() -> None:
    a, b, c = (math.radians(angle) for angle in (12.0, -7.0, 25.0))
    now = shift(0.4, -0.3, R_MM - 1.25) @ turn((0, b, 0)) @ turn((a, 0, 0)) @ turn((0, 0, c))
    assert labels(now) == expected(
        depth_mm=1.25, tilt_x_deg=12, tilt_y_deg=-7, shear_x_mm=0.4, shear_y_mm=-0.3, twist_deg=25
    )
    x, y, z = now.rotation @ np.array((0.0, 0.0, 1.0))  # as `core.touch.answer` has them of a contact's normal
    assert (-math.degrees(math.asin(y)), math.degrees(math.atan2(x, z))) == pytest.approx((12, -7))
