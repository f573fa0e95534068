from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.calibrated_sensor import FULL, references, sensor_of, simulated
from support.observed_presses import SEEDS, observed

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.indenters import Ball, stated_ball
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.machine import first_touch_mm, from_travel
from tacshade_edge.core.calibration.presses.table_check import (
    ShownSizes,
    size_mistake,
    table_hints,
    theil_sen_slope,
    travel_mistake,
    zero_hint,
)
from tacshade_edge.errors import ConfigError
from tacshade_edge.inference.network import load_networks
from tacshade_edge.simulator.script import ball_presses
from tacshade_edge.types import Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))


@given(st.integers(0, 2**32 - 1), st.integers(5, 40))
def test_the_slope_is_scipys(seed: int, count: int) -> None:
    from scipy.stats import theilslopes  # takes a second, which whoever only collects this need not spend

    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 5, count)
    y = 0.3 + 1.1 * x + 0.2 * rng.standard_normal(count)
    assert theil_sen_slope(x, y) == pytest.approx(theilslopes(y, x).slope)


@pytest.mark.parametrize(
    ("shown", "said"),
    [
        (ShownSizes(1.1, 0.53, 0.54), "are they diameters?"),
        (ShownSizes(0.82, 0.53, 0.54), "are they diameters?"),  # with a network that finds depths too small
        (ShownSizes(0.82, 0.79, 0.86), ""),  # depths 0.7 and 1 mm too great, of tools/studies/calibration.py's 8401
        (ShownSizes(0.73, 0.71, 0.84), ""),
        (ShownSizes(1.0, 0.79, 0.96), ""),  # a good table of a skin of 12 mm
        (ShownSizes(1.05, 0.79, 0.79), ""),  # a good table of a stiff skin on a soft gel (the third family)
        (ShownSizes(1.0, 2.1, 2.1), "are they halved?"),
        (ShownSizes(1.0, math.nan, math.nan), ""),
    ],
)
def test_balls_that_look_smaller_are_diameters_where_depths_do_not(shown: ShownSizes, said: str) -> None:
    assert size_mistake(shown, (), GEOMETRY).count("\n") == 0
    assert (said in size_mistake(shown, (), GEOMETRY)) if said else not size_mistake(shown, (), GEOMETRY)


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_a_true_table_has_no_hint(seed: int) -> None:
    presses, geometry = observed(seed)
    assert table_hints(presses, geometry) == ()
    assert table_hints([replace(o, x_mm=None, y_mm=None) for o in presses], geometry) == ()


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("unit", "factor"), [("cm", 0.1), ("inches", 1 / 25.4), ("m", 0.001)])
def test_another_unit_is_hinted(seed: int, unit: str, factor: float) -> None:
    presses, geometry = observed(seed)
    (hint,) = table_hints([replace(o, depth_mm=o.depth_mm * factor) for o in presses], geometry)
    assert hint.endswith(f"are the depths in {unit}? expected mm")


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("a", "b", "c", "d", "reading"),
    [
        (0, 1, 1, 0, "x and y are swapped"),
        (-1, 0, 0, 1, "x has the opposite sign"),
        (1, 0, 0, -1, "y has the opposite sign"),
        (-1, 0, 0, -1, "x and y have the opposite sign"),
        (0.1, 0, 0, 0.1, "x and y are in cm"),
        (0.001, 0, 0, 0.001, "x and y are in m"),
        (1 / 25.4, 0, 0, 1 / 25.4, "x and y are in inches"),
        (0, -1, -1, 0, "x and y are swapped and have the opposite sign"),
        (0, 1, -1, 0, "the axes are turned by 90 degrees"),
        (0, -1, 1, 0, "the axes are turned by -90 degrees"),
    ],
)
def test_other_axes_are_hinted(seed: int, a: float, b: float, c: float, d: float, reading: str) -> None:
    presses, geometry = observed(seed)
    other = []
    for press in presses:
        x, y = press.place_mm
        other.append(replace(press, x_mm=a * x + b * y, y_mm=c * x + d * y))
    (hint,) = table_hints(other, geometry)
    assert hint.endswith(f"if {reading}")


def set_of(count: int, seed: int) -> tuple[list[float], list[Ball]]:
    """What a network that is off by 7 % and 0.15 mm finds of balls."""
    rng = np.random.default_rng(seed)
    balls = [stated_ball(GEOMETRY, p.x_mm, p.y_mm, p.depth_mm, radius) for p, radius in ball_presses(FULL, count, seed)]
    return [0.93 * b.depth_max_mm(20.0) + 0.15 * float(rng.standard_normal()) for b in balls], balls


def lower(ball: Ball, by_mm: float) -> Ball:
    return replace(ball, z_mm=ball.z_mm - by_mm)


@pytest.mark.parametrize("off_mm", [-0.8, 0.8])
def test_a_constant_offset_is_measured(off_mm: float) -> None:
    found_mm, balls = set_of(24, 1)
    assert zero_hint(found_mm, balls, GEOMETRY) == ""
    hint = zero_hint(found_mm, [lower(ball, off_mm) for ball in balls], GEOMETRY)
    change = hint.removeprefix("the depths fit better if all are ").removesuffix(": check where depth is zero")
    size, unit, direction = change.split(" ")
    assert (unit, direction) == ("mm", "less" if off_mm > 0 else "more")
    assert float(size) == pytest.approx(0.8, abs=0.25)


def test_what_says_nothing_has_no_hint() -> None:
    found_mm, balls = set_of(24, 2)
    off = [lower(ball, 0.8) for ball in balls]
    assert zero_hint(found_mm, off, GEOMETRY) != ""
    assert zero_hint(found_mm[:11], off[:11], GEOMETRY) == ""  # too few
    assert zero_hint([2.0] * 24, off, GEOMETRY) == ""
    assert zero_hint([0.5 * h for h in found_mm], off, GEOMETRY) == ""  # no sensor of the network's kind


@pytest.fixture(scope="module")
def presses() -> list[KnownPress]:
    return [
        KnownPress(f"press {k}", simulated(FULL).frame((p,), 300 + k).image, radius, p.depth_mm, p.x_mm, p.y_mm)
        for k, (p, radius) in enumerate(ball_presses(FULL, 24, 3))
    ]


def stated_as(presses: list[KnownPress], off_mm: Callable[[KnownPress], float]) -> list[KnownPress]:
    table = [replace(press, depth_mm=press.depth_mm + off_mm(press)) for press in presses]
    return [press for press in table if press.depth_mm > 0]


def warnings_of(table: list[KnownPress]) -> tuple[str, ...]:
    networks = {"accurate": load_networks()["accurate"]}
    return calibrate(sensor_of(FULL), references(FULL), table, networks=networks).warnings


def less_first_touch(press: KnownPress) -> float:
    return -first_touch_mm(press.radius_mm, FULL.skin_radius_mm, press.x_mm or 0, press.y_mm or 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("off_mm", "wanted"),
    [(0.0, ""), (-0.7, "mm more: check where depth is zero"), (0.7, "mm less: check where depth is zero")],
)
def test_a_simulated_sensor(presses: list[KnownPress], off_mm: float, wanted: str) -> None:
    hints = [warning for warning in warnings_of(stated_as(presses, lambda _: off_mm)) if "fit better" in warning]
    assert len(hints) == bool(wanted)
    assert all(wanted in hint for hint in hints)


@pytest.mark.slow
def test_travel_from_first_touch_is_refused_and_read_where_it_is_asked_for(presses: list[KnownPress]) -> None:
    table = stated_as(presses, less_first_touch)
    with pytest.raises(
        ConfigError, match=r"PRESSES.csv: depth_mm: found travel from first touch.* --depth-from-touch,"
    ):
        warnings_of(table)
    read = [from_travel(press, FULL.skin_radius_mm) for press in table]
    assert [press.depth_mm for press in read] == pytest.approx([press.depth_mm for press in presses])
    assert warnings_of(read) == ()


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.7, 1.0, 1.4]), st.integers(12, 40))
def test_right_depths_are_not_taken_for_travel(seed: int, factor: float, count: int) -> None:
    found_mm, balls = set_of(count, seed)
    assert travel_mistake([factor * h for h in found_mm], balls, GEOMETRY) == ""


def test_few_presses_are_not_refused_as_travel() -> None:
    found_mm, balls = set_of(15, 3)
    travel = [lower(ball, first_touch_mm(ball.radius_mm, 20.0, ball.x_mm, ball.y_mm)) for ball in balls]
    assert travel_mistake(found_mm, travel, GEOMETRY) == ""
