from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.calibrated_sensor import calibrated, presses, unloaded

from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.presses.press_check import PressCheck
from tacshade_edge.core.calibration.presses.press_question import question
from tacshade_edge.core.calibration.presses.press_view import PressView
from tacshade_edge.inference.network import load_networks
from tacshade_edge.types import Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))
PRESS = KnownPress("press", np.zeros((2, 2), np.uint8), 12.0, 2.0, 6.0, -3.0)
RIGHT = PressView(2.0, 6.0, -3.0, 1.1)


@pytest.mark.parametrize(
    ("view", "asked"),
    [
        (RIGHT, ""),
        (replace(RIGHT, ball_factor=0.5), "looks like a ball of 6 mm; is 12 its diameter?"),
        (replace(RIGHT, ball_factor=2.2), ""),  # a small one may look so
        (replace(RIGHT, ball_factor=2.2, misfit_ratio=9.0), "looks like a ball of 26 mm; is its radius 12?"),
        (replace(RIGHT, x_mm=-3.2, y_mm=6.1), "the picture shows it around x -3, y 6 mm; are x and y swapped?"),
        (replace(RIGHT, x_mm=0.2), "the picture shows it around x 0, y -3 mm; is x 6, y -3 right?"),
        (replace(RIGHT, depth_mm=5.2), "looks about 5.2 mm deep; is the depth of 2 mm right?"),
    ],
)
def test_what_the_picture_shows_otherwise_is_asked_about(view: PressView, asked: str) -> None:
    assert question(view, PRESS, GEOMETRY) == asked


@pytest.mark.slow
def test_right_presses_are_not_asked_about_and_wrong_ones_are() -> None:
    check = PressCheck(calibrated(count=0), load_networks()["accurate"])
    assert [check.question(press) for press in presses()] == [""] * len(presses())
    wrong = max(presses(), key=lambda press: press.depth_mm)
    assert "its diameter?" in check.question(replace(wrong, radius_mm=2 * wrong.radius_mm))
    assert "the picture shows it" in check.question(replace(wrong, x_mm=(wrong.x_mm or 0) - 5))
    assert PressCheck(calibrated(count=0)).question(replace(wrong, radius_mm=2 * wrong.radius_mm)) == ""
    assert not check.judge(unloaded()).in_contact
