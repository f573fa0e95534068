"""Rows of honest tables and of tables in another order, against pictures that show them roughly."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.plausibility.row_order import ROWS_LEAST, Order, disagreement, judge_rows
from tacshade_edge.plausibility.suspicions import Suspicion, SuspicionCode
from tacshade_edge.types import F64, I64

PLACE_MM, DEPTH = 4.0, np.log(1.6)  # what is far apart on a skin of 20 mm


def table(seed: int, rows: int, size_mm: float = 20.0, noise: float = 1.0) -> tuple[F64, F64]:
    """Presses on a skin, and what pictures show of them: places and depths with their errors."""
    draw = np.random.default_rng(seed)
    part, scale = 0.6 * size_mm * np.sqrt(draw.uniform(0, 1, rows)), size_mm / 20
    turn = draw.uniform(0, 2 * np.pi, rows)
    stated = np.stack(
        (part * np.cos(turn), part * np.sin(turn), np.log(draw.uniform(0.5, 4, rows))), axis=1
    )
    errors = np.array([draw.uniform(0.2, 1) * scale, draw.uniform(0.2, 1) * scale, 0.15]) * noise
    seen = stated + draw.normal(0, 1, stated.shape) * errors
    unit = np.array([PLACE_MM * scale, PLACE_MM * scale, DEPTH])
    # Pictures that cannot be used.
    seen[draw.random(rows) < 0.05] = np.nan
    return stated / unit, seen / unit


def of_rows(stated: F64, seen: F64, order: I64, explained: float = 1.0) -> Suspicion | None:
    """What is found if each picture has the values of another row."""
    return judge_rows(stated[order], seen, explained)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 80), st.floats(5, 60), st.floats(0, 1.3))
def test_no_honest_table_is_suspected(seed: int, rows: int, size_mm: float, noise: float) -> None:
    stated, seen = table(seed, rows, size_mm, noise)
    assert judge_rows(stated, seen) is None
    # Balls whose places nobody stated.
    stated[:, :2] = np.nan
    assert judge_rows(stated, seen) is None


@settings(max_examples=200, deadline=None)
@given(
    st.integers(0, 10**6),
    st.integers(ROWS_LEAST + 4, 80),
    st.floats(5, 60),
    st.sampled_from(["before", "after", "reversed", "shuffled"]),
)
def test_another_order_is_named_and_refused(
    seed: int, rows: int, size_mm: float, case: str
) -> None:
    stated, seen = table(seed, rows, size_mm, 0.8)
    numbers = np.arange(rows)
    shuffled = np.random.default_rng(seed).permutation(rows)
    # Each picture has the values of these rows, so that its own stand elsewhere.
    order, right = {
        "before": (np.roll(numbers, 1), Order.BEFORE),
        "after": (np.roll(numbers, -1), Order.AFTER),
        "reversed": (numbers[::-1], Order.REVERSED),
        "shuffled": (shuffled, Order.OTHER),
    }[case]
    found = of_rows(stated, seen, order)
    assert found is not None
    assert (found.code, found.impossible) == (SuspicionCode.ROWS_OF_OTHERS, True)
    if case != "shuffled":
        assert found.values["order"] is right
        image, row = int(str(found.values["image"])), int(str(found.values["row"]))
        assert order[row] == image
    assert str(right) in str(found) or case == "shuffled"


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 60))
def test_rows_of_another_sensor_are_in_no_order(seed: int, rows: int) -> None:
    stated, _ = table(seed, rows)
    _, seen = table(seed + 1, rows)
    assert judge_rows(stated, seen) is None


def test_axes_that_explain_as_much_are_believed_before_another_order() -> None:
    place = np.array([(x, y) for x in range(-6, 7, 4) for y in range(-6, 7, 4)], np.float64) / 4
    swapped = place[:, ::-1]
    depth = np.random.default_rng(1).permutation(len(place))[:, None] / 4
    stated, seen = np.hstack((swapped, depth)), np.hstack((place, depth))
    assert judge_rows(np.roll(stated, 1, axis=0), seen, 1.0) is None
    # Without depths, the rows of a grid are in another order as well.
    moved = np.random.default_rng(2).permutation(len(place))
    assert judge_rows(place[moved], place) is None
    assert of_rows(seen, seen, moved) is not None
    assert of_rows(seen, seen, moved, explained=0.1) is None


def test_a_long_table_is_judged_by_its_neighbours_alone() -> None:
    stated, seen = table(1, 2000)
    found = of_rows(stated, seen, np.roll(np.arange(2000), 1))
    assert found is not None
    assert found.values["order"] is Order.BEFORE
    assert of_rows(stated, seen, np.random.default_rng(1).permutation(2000)) is None


def test_what_nobody_states_or_sees_disagrees() -> None:
    nothing = np.full((9, 3), np.nan)
    assert disagreement(nothing, nothing) == 1.0
    assert judge_rows(nothing, nothing) is None
    assert judge_rows(nothing, np.zeros((9, 3))) is None
