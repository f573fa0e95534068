from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from support.calibrated_sensor import FULL, calibrated, references, sensor_of, simulated
from support.calibrated_sensor import presses as half_presses
from support.observed_presses import SEEDS, observed
from support.stated_depths import GEOMETRY, right_depths
from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.findings import Axes, CalibrationFinding, FindingCode
from tacshade_edge.calibration.indenters import Ball
from tacshade_edge.calibration.inputs import KnownPress
from tacshade_edge.calibration.observation import PressObservation
from tacshade_edge.calibration.press_machine import from_travel
from tacshade_edge.calibration.presses.press_check import PressCheck
from tacshade_edge.calibration.presses.table_check import gross_mistakes, size_mistake, zero_hint
from tacshade_edge.calibration.sentences import FindingError, sentence
from tacshade_edge.lab.simulator.script import ball_presses
from tacshade_edge.sensor.inference.network import load_networks

Change = Callable[[PressObservation], PressObservation]


@pytest.mark.parametrize(
    ("depth", "ball", "said"),
    [
        (1.1, 0.53, "are they diameters?"),
        (0.82, 0.53, "are they diameters?"),  # with a network that finds depths too small
        (0.7, 0.68, ""),  # depths too great by a constant
        (
            1.0,
            0.79,
            "",
        ),  # good tables of a skin of 12 mm, and of a stiff skin on a soft gel (the third family)
        (1.0, 2.1, "are they halved?"),
        (1.0, math.nan, ""),
    ],
)
def test_balls_that_look_smaller_are_diameters_where_depths_do_not(
    depth: float, ball: float, said: str
) -> None:
    found = size_mistake(depth, ball, (), GEOMETRY)
    assert bool(said) == bool(found)
    assert found is None or said in sentence(found)


@cache
def seen() -> tuple[PressObservation, ...]:
    """True presses of `HALF`, also as a network sees them."""
    check = PressCheck(calibrated(count=0), load_networks()["accurate"])
    return tuple(check.observation(check.look(press.image), press) for press in half_presses())


def turned(a: float, b: float, c: float, d: float) -> Change:
    """Places read by other axes."""
    return lambda o: replace(
        o,
        x_mm=a * (o.x_mm or 0.0) + b * (o.y_mm or 0.0),
        y_mm=c * (o.x_mm or 0.0) + d * (o.y_mm or 0.0),
    )


def in_px(col: float, row: float, *, swapped: bool = False) -> Change:
    """Places read off the image, whose origin has this column and row from the circle's middle."""
    geometry = calibrated(count=0).geometry

    def change(o: PressObservation) -> PressObservation:
        x_mm, y_mm = o.x_mm or 0.0, o.y_mm or 0.0
        z_mm = math.sqrt(geometry.skin_radius_mm**2 - x_mm**2 - y_mm**2) - o.depth_mm
        px = geometry.f_px / (z_mm + (geometry.camera_distance_mm or 0.0))
        place = (col + px * x_mm, row + px * y_mm)
        return replace(o, x_mm=place[swapped], y_mm=place[not swapped])

    return change


MISTAKES: dict[str, Change] = {
    "": lambda o: o,
    "are the depths in cm?": lambda o: replace(o, depth_mm=o.depth_mm / 10),
    "are the depths in inches?": lambda o: replace(o, depth_mm=o.depth_mm / 25.4),
    "are the depths in m?": lambda o: replace(o, depth_mm=o.depth_mm / 1000),
    "are they diameters?": lambda o: replace(o, ball_factor=o.ball_factor / 2),
    "are they halved?": lambda o: replace(o, ball_factor=o.ball_factor * 2),
    "if x and y are swapped": turned(0, 1, 1, 0),
    "if x has the opposite sign": turned(-1, 0, 0, 1),
    "if y has the opposite sign": turned(1, 0, 0, -1),
    "if x and y have the opposite sign": turned(-1, 0, 0, -1),
    "if x and y are swapped and have the opposite sign": turned(0, -1, -1, 0),
    "if the axes are turned by 90 degrees": turned(0, 1, -1, 0),
    "if the axes are turned by -90 degrees": turned(0, -1, 1, 0),
    "if x and y are in cm": turned(0.1, 0, 0, 0.1),
    "if x and y are in m": turned(0.001, 0, 0, 0.001),
    "if x and y are in inches": turned(1 / 25.4, 0, 0, 1 / 25.4),
    "if x and y are in µm": turned(1000, 0, 0, 1000),
    "if x and y are columns and rows in px": in_px(163.8, 118.2),
    "if x and y are rows and columns in px": in_px(163.8, 118.2, swapped=True),
    "if x and y are in px from the middle of the visible circle": in_px(0, 0),
}


@pytest.mark.slow
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_gross_mistake_of_the_table_is_named(mistake: str) -> None:
    geometry = calibrated(count=0).geometry
    found = gross_mistakes([MISTAKES[mistake](o) for o in seen()], geometry)
    assert len(found) == bool(mistake)
    assert all(mistake in sentence(one) for one in found)
    unplaced = [replace(MISTAKES[mistake](o), x_mm=None, y_mm=None) for o in seen()]
    assert len(gross_mistakes(unplaced, geometry)) == ("they" in mistake or "depths" in mistake)


ORDERS: dict[str, Callable[[int], int]] = {
    "the row before?": lambda k: k - 1,
    "the row after?": lambda k: k + 1,
    "in the opposite order?": lambda k: -1 - k,
    "in another order?": lambda k: 7 * k,  # of 20
}


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
def test_values_of_other_rows_are_named_with_their_images(order: str) -> None:
    geometry, table = calibrated(count=0).geometry, half_presses()
    of = [ORDERS[order](k) % len(table) for k in range(len(table))]
    wrong = [
        replace(
            press, x_mm=table[k].x_mm, y_mm=table[k].y_mm, depth_mm=table[k].depth_mm, radius_mm=5.0
        )
        for press, k in zip(table, of, strict=True)
    ]
    observations = [
        replace(o, x_mm=p.x_mm, y_mm=p.y_mm, depth_mm=p.depth_mm)
        for o, p in zip(seen(), wrong, strict=True)
    ]
    assert gross_mistakes(seen(), geometry, table) == ()
    (found,) = gross_mistakes(observations, geometry, wrong)
    assert found.code is FindingCode.OTHER_ROWS
    assert order in sentence(found)
    image, row = (int(str(found.values[name]).removeprefix("press ")) for name in ("image", "row"))
    assert of[row] == image
    # Some of the images show nothing.
    assert gross_mistakes(observations[2:-1], geometry, wrong)[0].code is FindingCode.OTHER_ROWS
    # Without places, the depths show an order that is simple.
    unplaced = [replace(press, x_mm=None, y_mm=None) for press in wrong]
    bare = [replace(o, x_mm=None, y_mm=None) for o in observations]
    found_codes = [one.code for one in gross_mistakes(bare, geometry, unplaced)]
    assert (FindingCode.OTHER_ROWS in found_codes) == (order != "in another order?")


@pytest.mark.slow
def test_places_on_the_other_side_of_the_middle_show_no_size_of_the_skin() -> None:
    table = [replace(o, x_mm=-(o.y_mm or 0.0), y_mm=-(o.x_mm or 0.0)) for o in seen()[::-1]]
    assert all(
        one.code is not FindingCode.SKIN_SIZE
        for one in gross_mistakes(table, calibrated(count=0).geometry)
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_axes_are_judged_without_a_network_too(seed: int) -> None:
    presses, geometry = observed(seed)
    assert gross_mistakes(presses, geometry) == ()
    (hint,) = gross_mistakes([turned(0, 1, 1, 0)(o) for o in presses], geometry)
    assert hint.values["axes"] is Axes.SWAPPED


def lower(ball: Ball, by_mm: float) -> Ball:
    return replace(ball, z_mm=ball.z_mm - by_mm)


@pytest.mark.parametrize("off_mm", [-0.8, 0.8])
def test_a_constant_offset_is_measured(off_mm: float) -> None:
    found_mm, balls = right_depths(24, 1)
    assert zero_hint(found_mm, balls, GEOMETRY) is None
    hint = zero_hint(found_mm, [lower(ball, off_mm) for ball in balls], GEOMETRY)
    assert hint is not None
    greater, smaller = FindingCode.DEPTHS_TOO_GREAT, FindingCode.DEPTHS_TOO_SMALL
    assert hint.code is (greater if off_mm > 0 else smaller)
    assert hint.values["by_mm"] == pytest.approx(0.8, abs=0.25)


def test_what_says_nothing_has_no_hint() -> None:
    found_mm, balls = right_depths(24, 2)
    off = [lower(ball, 0.8) for ball in balls]
    assert zero_hint(found_mm, off, GEOMETRY) is not None
    assert zero_hint(found_mm[:11], off[:11], GEOMETRY) is None  # too few
    assert zero_hint([2.0] * 24, off, GEOMETRY) is None
    assert (
        zero_hint([0.5 * h for h in found_mm], off, GEOMETRY) is None
    )  # no sensor of the network's kind


@pytest.fixture(scope="module")
def presses() -> list[KnownPress]:
    return [
        KnownPress(
            f"press {k}",
            simulated(FULL).frame((p,), 300 + k).image,
            radius,
            p.depth_mm,
            p.x_mm,
            p.y_mm,
        )
        for k, (p, radius) in enumerate(ball_presses(FULL, 24, 3))
    ]


def stated_as(presses: list[KnownPress], off_mm: Callable[[KnownPress], float]) -> list[KnownPress]:
    table = [replace(press, depth_mm=press.depth_mm + off_mm(press)) for press in presses]
    return [press for press in table if press.depth_mm > 0]


def warnings_of(table: list[KnownPress]) -> tuple[CalibrationFinding, ...]:
    networks = {"accurate": load_networks()["accurate"]}
    return calibrate(sensor_of(FULL), references(FULL), table, networks=networks).warnings


def less_first_touch(press: KnownPress) -> float:
    return -Ball(press.x_mm or 0, press.y_mm or 0, 0, press.radius_mm).first_touch_mm(
        FULL.skin_radius_mm
    )


@pytest.mark.slow
def test_a_simulated_sensor(presses: list[KnownPress]) -> None:
    said = [sentence(warning) for warning in warnings_of(stated_as(presses, lambda _: 0.7))]
    assert "mm less: check where depth is zero" in " ".join(said)


@pytest.mark.slow
def test_travel_from_first_touch_is_refused_and_read_where_it_is_asked_for(
    presses: list[KnownPress],
) -> None:
    table = stated_as(presses, less_first_touch)
    with pytest.raises(
        FindingError, match=r"PRESSES.csv: depth_mm: found travel from first touch"
    ) as refused:
        warnings_of(table)
    (travel,) = refused.value.findings
    assert travel.code is FindingCode.TRAVEL
    read = [from_travel(press, FULL.skin_radius_mm) for press in table]
    assert [press.depth_mm for press in read] == pytest.approx(
        [press.depth_mm for press in presses]
    )
    assert warnings_of(read) == ()


@pytest.mark.parametrize(("seed", "factor", "count"), [(8154, 0.7, 31)])
def test_right_depths_that_look_like_travel_are_not_refused(
    seed: int, factor: float, count: int
) -> None:
    found_mm, balls = right_depths(count, seed)
    assert zero_hint([factor * h for h in found_mm], balls, GEOMETRY) is None


@pytest.mark.slow
def test_a_shell_that_spreads_dents_is_not_taken_for_halved_radii() -> None:
    geometry = calibrated(count=0).geometry
    wider = [replace(o, ball_factor=math.hypot(o.ball_factor, 15 / o.radius_mm)) for o in seen()]
    assert np.median([o.ball_factor for o in wider]) > 1.85
    assert gross_mistakes(wider, geometry) == ()
    halved = [replace(o, radius_mm=o.radius_mm / 2, ball_factor=2 * o.ball_factor) for o in wider]
    (found,) = gross_mistakes(halved, geometry)
    assert "are they halved?" in sentence(found)
