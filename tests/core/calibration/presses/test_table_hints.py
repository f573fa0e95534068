from __future__ import annotations

from dataclasses import replace

import pytest
from support.observed_presses import SEEDS, observed

from tacshade_edge.core.calibration.presses.table_hints import table_hints


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
    assert hint.endswith(f"are the depths in {unit}?")


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
