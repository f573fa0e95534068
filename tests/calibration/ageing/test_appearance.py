"""How a worn sensor at rest looks beside its calibration's reference."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from support.calibrated_sensor import HALF, calibrated, sensor_of
from support.painted_sensor import FREE, painted_calibration
from tacshade_edge.calibration.ageing.appearance import Appearance, appearance
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.sensor_model import flattened
from tacshade_edge.types import Disc
from tools.testbed.simulator.wear import Wear, WornSensor


@cache
def seen(wear: Wear) -> Appearance:
    sensor = WornSensor(HALF, wear)
    found = appearance(calibrated(HALF), [sensor.frame((), 900 + k).image for k in range(10)])
    assert found is not None
    return found


def test_a_sound_sensor_looks_as_it_did() -> None:
    sound = seen(Wear())
    assert max(abs(sound.white), abs(sound.dark)) < 0.01
    assert math.hypot(sound.slope_row, sound.slope_col) < 0.01
    assert abs(sound.sunk_mm) < 0.03
    assert sound.bent_part == 0


def test_lamps_dim_markers_and_pins_alike() -> None:
    dim = seen(Wear(dimmed=0.3))
    assert dim.white == pytest.approx(math.log(0.7), abs=0.02)
    assert dim.dark == pytest.approx(math.log(0.7), abs=0.05)
    assert abs(dim.sunk_mm) < 0.03
    assert dim.bent_part == 0


def test_one_lamp_dims_one_side() -> None:
    side = seen(Wear(dimmed_side=0.4))
    assert side.white < -0.15
    assert math.hypot(side.slope_row, side.slope_col) > 0.15


def test_faded_markers_leave_the_pins_as_dark_as_before() -> None:
    faded = seen(Wear(faded=0.4))
    assert faded.white < -0.25
    assert faded.dark > 0.3 * faded.white
    assert abs(faded.sunk_mm) < 0.05
    assert faded.bent_part == 0


def test_bent_pins_show_another_pattern_and_the_more_the_more_bend() -> None:
    few, many = (seen(Wear(bent_mm=1.0, bent_radius_mm=radius)) for radius in (2.5, 5.0))
    assert 0.01 < few.bent_part < many.bent_part
    assert abs(few.white) < 0.02
    assert abs(few.sunk_mm) < 0.05


def test_a_sunken_skin_is_no_zoom_of_the_camera() -> None:
    some, more = (seen(Wear(leaked_mm=mm)) for mm in (0.2, 0.4))
    assert 0.1 < some.sunk_mm < 0.4
    assert 1.5 < more.sunk_mm / some.sunk_mm < 2.5
    assert more.bent_part == 0


def test_dust_and_a_resting_object_change_the_pattern_too() -> None:
    disc, free = HALF.geometry.disc, WornSensor(HALF, Wear()).frame((), 900).image
    dusty = camera_faults.speck(free, disc.row_c + 20, disc.col_c, 9)
    found = appearance(calibrated(HALF), [dusty])
    assert found is not None
    assert found.bent_part > 0.01


@pytest.mark.parametrize("level", [0, 120, 255])
def test_a_picture_without_a_pattern_shows_another_one(level: int) -> None:
    found = appearance(painted_calibration(), [np.full_like(FREE, level)])
    assert found is not None
    assert found.bent_part == 1


def test_a_pad_sinks_too() -> None:
    flat = flattened(HALF)
    sound, sunk = (WornSensor(flat, Wear(leaked_mm=mm)) for mm in (0.0, 0.3))
    known = calibrate(sensor_of(flat), [sound.frame((), k).image for k in range(5)], ())
    found = appearance(known.calibration, [sunk.frame((), 900 + k).image for k in range(10)])
    assert found is not None
    assert 0.1 < found.sunk_mm < 0.7


def test_a_disc_that_is_too_small_shows_nothing() -> None:
    known = painted_calibration()
    small = replace(known, geometry=replace(known.geometry, disc=Disc(59.5, 79.5, 9.0)))
    assert appearance(small, [FREE]) is None
