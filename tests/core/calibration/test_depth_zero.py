from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import theilslopes
from support.calibrated_sensor import FULL, references, sensor_of, simulated

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.depth_zero import theil_sen, zero_hint
from tacshade_edge.core.calibration.gain import Ball, stated_ball
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.devices.weights.network import load_networks
from tacshade_edge.simulator.calibration_set import ball_presses
from tacshade_edge.types import Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))


@given(st.integers(0, 2**32 - 1), st.integers(5, 40))
def test_the_line_is_scipys(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 5, count)
    y = 0.3 + 1.1 * x + 0.2 * rng.standard_normal(count)
    expected, line = theilslopes(y, x, 0.95), theil_sen(x, y)
    assert line.slope == pytest.approx(expected.slope)
    assert line.offset == pytest.approx(expected.intercept)
    assert line.offset_low == pytest.approx(np.median(y) - expected.high_slope * np.median(x))
    assert line.offset_high == pytest.approx(np.median(y) - expected.low_slope * np.median(x))


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
    change = hint.removeprefix("the depths fit better if all are ").removesuffix(": check the zero of the depth")
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("read_as", "wanted"),
    [
        ("stated", ""),
        ("less", "mm more: check the zero"),
        ("more", "mm less: check the zero"),
        ("travel", "fit better as travel from first touch"),
    ],
)
def test_a_simulated_sensor(presses: list[KnownPress], read_as: str, wanted: str) -> None:
    r = FULL.skin_radius_mm

    def depth_mm(press: KnownPress) -> float:
        beside2 = (press.x_mm or 0.0) ** 2 + (press.y_mm or 0.0) ** 2
        touch = np.sqrt(r * r - beside2) - np.sqrt((r + press.radius_mm) ** 2 - beside2) + press.radius_mm
        off = {"stated": 0.0, "less": -0.7, "more": 0.7, "travel": -float(touch)}[read_as]
        return press.depth_mm + off

    table = [replace(press, depth_mm=depth_mm(press)) for press in presses if depth_mm(press) > 0]
    networks = {"accurate": load_networks()["accurate"]}
    warnings = calibrate(sensor_of(FULL), references(FULL), table, networks=networks).warnings
    hints = [warning for warning in warnings if "fit better" in warning]
    assert len(hints) == bool(wanted)
    assert all(wanted in hint for hint in hints)
