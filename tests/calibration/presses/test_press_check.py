from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from support.calibrated_sensor import HALF, calibrated, presses, simulated, unloaded
from tacshade_edge.calibration.findings import FindingCode
from tacshade_edge.calibration.indenters import box
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.observation import PressObservation
from tacshade_edge.calibration.presses.press_check import PressCheck
from tacshade_edge.lab.simulator.press import Press, ridge
from tacshade_edge.sensor.inference.network import load_networks


@cache
def check() -> PressCheck:
    return PressCheck(calibrated(count=0), load_networks()["accurate"])


def seen(press: KnownPress) -> PressObservation:
    found = check().observation(check().look(press.image), press)
    assert found.is_seen
    return found


@pytest.mark.slow
def test_balls_are_seen_where_they_are_and_as_large_as_they_are() -> None:
    for press in presses():
        found = seen(press)
        assert found.place_error_mm(*found.place_mm) < 0.8, press.name
        assert found.ball_factor > 0.8, press.name
        assert not check().question(check().look(press.image), press), press.name
    assert not check().judge(check().look(unloaded())).in_contact


@pytest.mark.slow
@pytest.mark.parametrize(("stated", "low", "high"), [(2.0, 0.4, 0.62), (0.5, 1.6, 2.6)])
def test_a_ball_of_another_radius_is_seen(stated: float, low: float, high: float) -> None:
    deep = [press for press in presses() if press.depth_mm > 1]
    wrong = [replace(press, radius_mm=stated * press.radius_mm) for press in deep]
    assert low < float(np.median([seen(press).ball_factor for press in wrong])) < high
    asked = [check().question(check().look(press.image), press) for press in wrong]
    code = FindingCode.LOOKS_SMALLER if stated > 1 else FindingCode.LOOKS_LARGER
    assert sum(each is not None and each.code is code for each in asked) >= 0.9 * len(asked)


@pytest.mark.slow
def test_another_indenter_is_located_beside_its_stated_place() -> None:
    image = simulated(HALF).frame((Press(ridge(8.0, 6.0), 3.0, -2.0, 2.0),), 9).image
    stated = KnownPress("square", image, 0.0, 2.0, 3.0, -2.0, box("square", 8.0, 6.0))
    assert seen(stated).place_error_mm(3.0, -2.0) < 0.6
    moved = seen(replace(stated, x_mm=6.0))
    assert moved.place_error_mm(3.0, -2.0) < 1.2
    assert math.isnan(moved.ball_factor)
