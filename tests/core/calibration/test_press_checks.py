"""On presses that follow a law of their own, so that what is wrong with each is known exactly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.core.calibration.press_checks import (
    Evidence,
    agreement_mm,
    coverage,
    disagreements,
    first_touch_mm,
    hints,
)
from tacshade_edge.types import Disc, Geometry

GEOMETRY = Geometry(20.0, 14.0, 50.0, Disc(100, 100, 80))
VISIBLE_MM = 20 * math.sin(math.radians(50))


def press_set(seed: int = 0, count: int = 24, noise: float = 0.04) -> list[Evidence]:
    """Presses spread over place, depth and radius; χ follows the travel by a power law, and noise of a few percent."""
    rng = np.random.default_rng(seed)
    rows = []
    for k, (depth_cell, radius_cell) in enumerate(zip(rng.permutation(count), rng.permutation(count), strict=True)):
        rho, angle = 0.66 * VISIBLE_MM * math.sqrt((k + 0.5) / count), 2.4 * k
        x, y = rho * math.cos(angle), rho * math.sin(angle)
        radius, depth = 3 + 6 * radius_cell / count, 0.5 + 3.5 * depth_cell / count
        row = Evidence(f"press {k}", 1.0, 30.0, 30.0, x, y, radius, depth, x, y)
        travel = depth - float(first_touch_mm([row], GEOMETRY)[0])
        chi = (travel * radius**0.3 / 0.3) ** 0.8 * math.exp(noise * rng.standard_normal())
        off_x, off_y = 0.5 * rng.standard_normal(2)
        rows.append(replace(row, chi_grey=chi, found_x_mm=x + off_x, found_y_mm=y + off_y))
    return rows


def changed(rows: Sequence[Evidence], k: int, **stated: float) -> list[Evidence]:
    return [replace(row, **stated) if i == k else row for i, row in enumerate(rows)]


def test_first_touch() -> None:
    middle = Evidence("", 1, 1, 1, 0, 0, 6.0, 1.0, 0.0, 0.0)
    beside = replace(middle, x_mm=8.0)
    assert first_touch_mm([middle], GEOMETRY) == pytest.approx(0, abs=1e-9)
    # A ball at (8, 0) touches when the centres are 26 mm apart.
    expected = math.sqrt(400 - 64) - (math.sqrt(26**2 - 64) - 6)
    assert first_touch_mm([beside], GEOMETRY) == pytest.approx(expected)
    assert expected < -0.3


@settings(max_examples=10)
@given(st.integers(0, 10_000))
def test_good_presses_pass_without_a_word(seed: int) -> None:
    rows = press_set(seed)
    assert disagreements(rows, GEOMETRY) == ()
    assert hints(rows, GEOMETRY) == ()
    assert coverage(rows, GEOMETRY) == ()
    assert agreement_mm(rows, GEOMETRY) < 0.2


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.integers(0, 23), st.sampled_from([0.4, 2.5]))
def test_a_false_depth_is_named_and_the_true_one_is_found(seed: int, k: int, factor: float) -> None:
    rows = press_set(seed)
    true_mm = rows[k].depth_mm
    stated_mm = true_mm * factor
    if abs(stated_mm - true_mm) < 1.2:
        stated_mm = true_mm + 2.0
    named = {found.index: found.reason for found in disagreements(changed(rows, k, depth_mm=stated_mm), GEOMETRY)}
    assert k in named
    assert len(named) <= 2
    assert named[k].startswith(f"press {k}: depth {stated_mm:.2f} mm is stated, ")
    found_mm = float(named[k].split("is stated, ")[1].split(" mm")[0])
    assert found_mm == pytest.approx(true_mm, abs=1.0)


@settings(max_examples=20)
@given(st.integers(0, 10_000), st.integers(0, 23), st.floats(0, 2 * math.pi))
def test_a_false_place_is_named(seed: int, k: int, angle: float) -> None:
    rows = press_set(seed)
    x, y = rows[k].place_mm
    moved = changed(rows, k, x_mm=x + 6 * math.cos(angle), y_mm=y + 6 * math.sin(angle))
    (found,) = disagreements(moved, GEOMETRY)
    assert found.index == k
    assert "is what the image shows" in found.reason


def test_several_wrong_ones_do_not_hide_each_other() -> None:
    rows, wrong = press_set(), {3, 9, 14, 20}
    for k in wrong:
        rows = changed(rows, k, depth_mm=rows[k].depth_mm + 2.5)
    assert {found.index for found in disagreements(rows, GEOMETRY)} == wrong


def test_presses_without_a_place_are_judged_where_they_were_found() -> None:
    rows = [replace(row, x_mm=None, y_mm=None) for row in press_set()]
    assert disagreements(rows, GEOMETRY) == ()
    (found,) = disagreements(changed(rows, 5, depth_mm=rows[5].depth_mm + 2.5), GEOMETRY)
    assert found.index == 5


@pytest.mark.parametrize(("unit", "factor"), [("cm", 0.1), ("inches", 1 / 25.4), ("m", 0.001)])
def test_another_unit_is_hinted(unit: str, factor: float) -> None:
    rows = [replace(row, depth_mm=row.depth_mm * factor) for row in press_set()]
    (hint,) = hints(rows, GEOMETRY)
    assert hint.endswith(f"are the depths in {unit}?")


@pytest.mark.parametrize(
    ("a", "b", "c", "d", "said"),
    [
        (0, 1, 1, 0, "x and y are swapped"),
        (-1, 0, 0, 1, "x has the other sign"),
        (1, 0, 0, -1, "y has the other sign"),
        (-1, 0, 0, -1, "x and y have the other sign"),
        (0.1, 0, 0, 0.1, "x and y are in cm"),
        (0, 1, -1, 0, "the axes are turned by 90 degrees"),
        (0, -1, 1, 0, "the axes are turned by -90 degrees"),
    ],
)
def test_other_axes_are_hinted(a: float, b: float, c: float, d: float, said: str) -> None:
    rows = []
    for row in press_set():
        x, y = row.place_mm
        rows.append(replace(row, x_mm=a * x + b * y, y_mm=c * x + d * y))
    assert any(hint.endswith(f"if {said}") for hint in hints(rows, GEOMETRY))


def test_another_zero_is_hinted() -> None:
    rows = press_set(noise=0.02)
    touch = first_touch_mm(rows, GEOMETRY)
    travel = [replace(row, depth_mm=row.depth_mm - float(t)) for row, t in zip(rows, touch, strict=True)]
    (hint,) = hints(travel, GEOMETRY)
    assert "travel from first touch" in hint
    offset = [replace(row, depth_mm=row.depth_mm + 1.0) for row in rows]
    (hint,) = hints(offset, GEOMETRY)
    assert "mm less: check the zero" in hint


@settings(max_examples=20)
@given(
    st.lists(
        st.tuples(
            st.floats(1e-3, 200),
            st.floats(0.1, 200),
            st.floats(0.1, 1000),
            st.floats(-20, 20),
            st.floats(-20, 20),
            st.floats(0.01, 1000),
            st.floats(1e-4, 19.9),
        ),
        min_size=1,
        max_size=12,
    )
)
def test_nothing_breaks_it(numbers: list[tuple[float, ...]]) -> None:
    rows = [Evidence(str(k), *values, values[3] * 3, -values[4]) for k, values in enumerate(numbers)]
    assert all(0 <= found.index < len(rows) for found in disagreements(rows, GEOMETRY))
    assert all(isinstance(line, str) for line in (*hints(rows, GEOMETRY), *coverage(rows, GEOMETRY)))
    assert math.isfinite(agreement_mm(rows, GEOMETRY))


def test_what_is_missing_is_named() -> None:
    rows = press_set()
    assert coverage([], GEOMETRY) == ()

    def said(some: Sequence[Evidence]) -> str:
        return "\n".join(coverage(some, GEOMETRY))

    assert "10 presses: 20 to 40" in said(rows[::2][:10])
    assert "close together, around x 0, y 0" in said(
        [replace(row, x_mm=row.x_mm / 5, y_mm=row.y_mm / 5) for row in rows if row.x_mm and row.y_mm]
    )
    assert "no press lies at x < 0" in said([replace(row, x_mm=abs(row.x_mm or 0)) for row in rows])
    assert "all 1.0 to 1.5 mm deep" in said([replace(row, depth_mm=1 + k / 46) for k, row in enumerate(rows)])
    assert "no press is deeper than 2.0 mm" in said([replace(row, depth_mm=row.depth_mm / 1.9) for row in rows])
    assert "one ball radius, 6 mm" in said([replace(row, radius_mm=6.0) for row in rows])
    assert "ball radii of 5 to 6 mm only" in said([replace(row, radius_mm=5 + k % 2) for k, row in enumerate(rows)])
