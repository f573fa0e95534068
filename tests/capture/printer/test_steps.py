from __future__ import annotations

import itertools
import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.capture.printer.steps import Expected, descent, search, segments

HEIGHT = st.floats(-200, 200)


@given(HEIGHT, HEIGHT, st.floats(0, 40))
def test_a_descent_goes_down_to_its_end_and_never_below_it(from_z: float, touch_z: float, lower: float) -> None:
    to_z = from_z - lower
    steps = list(descent(from_z, touch_z, to_z))
    heights = [from_z, *(step.z_mm for step in steps)]
    assert all(before > after for before, after in itertools.pairwise(heights))
    assert heights[-1] == (to_z if lower else from_z)
    for before, step in zip(heights, steps, strict=False):
        short = step.z_mm < touch_z + 1
        assert before - step.z_mm <= (0.5 if short else 2.0) + 1e-9


def test_what_is_seen_must_fit_the_place() -> None:
    expected = {step.z_mm: step.expected for step in descent(14.0, 10.0, 8.5)}
    assert expected == {
        12.0: Expected.FREE,
        11.0: Expected.FREE,
        10.5: Expected.FREE,
        10.0: Expected.ANYTHING,
        9.5: Expected.ANYTHING,
        9.0: Expected.TOUCHED,
        8.5: Expected.TOUCHED,
    }


@given(HEIGHT, HEIGHT, st.floats(0.05, 2))
def test_a_search_ends_above_the_least(from_z: float, least_z: float, step_mm: float) -> None:
    heights = [from_z, *search(from_z, least_z, step_mm)]
    assert all(z >= least_z - 1e-9 for z in heights[1:])
    assert all(0 < before - after <= step_mm + 1e-9 for before, after in itertools.pairwise(heights))


@given(st.lists(HEIGHT, min_size=6, max_size=6), st.floats(0.5, 50))
def test_no_part_of_a_move_is_longer(places: list[float], longest_mm: float) -> None:
    start, end = np.array(places[:3]), np.array(places[3:])
    parts = segments(start, end, longest_mm)
    assert np.array_equal(parts[-1], end)
    assert all(math.dist(a, b) <= longest_mm + 1e-6 for a, b in itertools.pairwise((start, *parts)))
