"""Labels of honest tables and in other units, against a map that is off and trembles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.plausibility.label_columns import judge_labels
from tacshade_edge.plausibility.row_order import Order, name_orders
from tacshade_edge.plausibility.suspicions import SuspicionCode
from tacshade_edge.plausibility.units import ANGLES, LENGTHS
from tacshade_edge.types import F64

Table = dict[str, F64]


def table(
    seed: int, *, size_mm: float = 20.0, rows: int = 60, noise: float = 1.0
) -> tuple[Table, Table]:
    """Labels and what a map shows of them: factors of its own, and noise."""
    draw = np.random.default_rng(seed)
    part = size_mm / 20
    depth = draw.uniform(0.4, 3, rows) * part
    labels = {"depth_mm": depth, "force_z_n": depth * 3}
    seen = {"depth_mm": depth * draw.uniform(0.6, 1.3) + draw.normal(0, 0.2 * noise * part, rows)}
    for name in ("tilt_x_deg", "tilt_y_deg"):
        labels[name] = draw.uniform(-12, 12, rows)
        seen[name] = labels[name] * draw.uniform(0.6, 1.2) + draw.normal(0, 2 * noise, rows)
    for name in ("shear_x_mm", "shear_y_mm"):
        labels[name] = draw.uniform(-2, 2, rows) * part
        seen[name] = labels[name] * 0.5 + draw.normal(0, part, rows)
    labels["tilt_x_deg"][:3] = seen["depth_mm"][3:6] = np.nan
    return labels, seen


@settings(max_examples=200, deadline=None)
@given(
    st.integers(0, 10**6),
    st.floats(5, 60),
    st.integers(2, 200),
    st.floats(0, 4),
    st.floats(0.02, 1),
)
def test_no_honest_table_is_suspected(
    seed: int, size_mm: float, rows: int, noise: float, span: float
) -> None:
    labels, seen = table(seed, size_mm=size_mm, rows=max(rows, 7), noise=noise)
    # Few tilts of a narrow range, which noise drowns.
    labels["tilt_y_deg"] *= span
    seen["tilt_y_deg"] = labels["tilt_y_deg"] + np.random.default_rng(seed).normal(
        0, 3, len(seen["tilt_y_deg"])
    )
    assert judge_labels(labels, seen) == ()


@settings(max_examples=100, deadline=None)
@given(
    st.integers(0, 10**6),
    st.floats(5, 60),
    st.sampled_from(
        [("depth_mm", unit) for unit in LENGTHS]
        + [(name, unit) for name in ("tilt_x_deg", "tilt_y_deg") for unit in ANGLES]
    ),
)
def test_another_unit_is_named_and_refused(
    seed: int, size_mm: float, case: tuple[str, str]
) -> None:
    labels, seen = table(seed, size_mm=size_mm)
    name, unit = case
    labels[name] = labels[name] / (LENGTHS | ANGLES)[unit]  # type: ignore[index]
    (found,) = judge_labels(labels, seen)
    assert found.code is SuspicionCode.LABEL_UNIT
    assert found.values["name"] == name
    # Centimetres and inches are near to each other.
    if unit not in ("cm", "inches"):
        assert found.impossible
        assert found.values["unit"] == unit


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(["depth_mm", "tilt_x_deg", "tilt_y_deg"]))
def test_the_opposite_sign_is_doubted(seed: int, name: str) -> None:
    labels, seen = table(seed)
    labels[name] = -labels[name]
    (found,) = judge_labels(labels, seen)
    assert (found.code, found.impossible) == (SuspicionCode.LABEL_SIGN, False)
    assert str(found).startswith(f"{name}: ")


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_swapped_tilts_are_doubted(seed: int) -> None:
    labels, seen = table(seed)
    labels["tilt_x_deg"], labels["tilt_y_deg"] = labels["tilt_y_deg"], labels["tilt_x_deg"]
    assert [one.code for one in judge_labels(labels, seen)] == [SuspicionCode.LABELS_SWAPPED]


NAMES = [f"frame_{k}.png" for k in range(60)]
ORDERS = {
    Order.BEFORE: np.roll(np.arange(60), 1),
    Order.AFTER: np.roll(np.arange(60), -1),
    Order.REVERSED: np.arange(60)[::-1],
}


def number_in(name: str) -> int:
    return int(name[6:-4])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(list(ORDERS)))
def test_a_table_in_another_order_is_refused(seed: int, order: Order) -> None:
    labels, seen = table(seed)
    (found,) = judge_labels({name: one[ORDERS[order]] for name, one in labels.items()}, seen)
    assert (found.code, found.impossible) == (SuspicionCode.LABELS_SHIFTED, True)
    assert str(found).endswith(order)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_a_table_whose_images_are_sorted_otherwise_than_its_values_is_refused(
    seed: int, as_text: bool
) -> None:
    labels, seen = table(seed)
    of = {name: k for k, name in enumerate(NAMES)}
    # The images of the table, in the order of its rows, and what each shows.
    names = sorted(NAMES) if as_text else NAMES
    shown = [of[name] for name in names]
    stated = np.arange(60) if as_text else np.array([of[name] for name in sorted(NAMES)])
    mixed = {name: one[stated] for name, one in labels.items()}
    frames = {name: one[shown] for name, one in seen.items()}
    (found,) = judge_labels(mixed, frames, orders=name_orders(names, number_in))
    assert found.values["order"] is (Order.BY_TEXT if as_text else Order.BY_NUMBER)
    # Of rows that belong together, no order is better.
    honest = {name: one[shown] for name, one in labels.items()}
    assert judge_labels(honest, frames, orders=name_orders(names, number_in)) == ()
    assert name_orders([*names, names[0]], number_in) == {}


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), st.integers(40, 200))
def test_a_column_that_goes_with_nothing_is_doubted_unless_it_is_learnt(
    seed: int, rows: int
) -> None:
    labels, seen = table(seed, rows=rows)
    draw = np.random.default_rng(seed)
    labels["depth_mm"] = draw.permutation(labels["depth_mm"])
    names = [one.values["name"] for one in judge_labels(labels, seen)]
    by_chance = abs(np.corrcoef(labels["depth_mm"], labels["force_z_n"])[0, 1]) > 1 / np.sqrt(rows)
    assert names == ["depth_mm"] or by_chance
    assert judge_labels(labels, seen, learnt={"depth_mm", "force_z_n"}) == ()
    # All depths are alike, so that they show nothing of each other.
    labels["depth_mm"] = 1 + labels["depth_mm"] / 100
    assert judge_labels(labels, seen) == ()


def test_a_shuffled_table_is_doubted_by_each_quantity_that_goes_with_depth() -> None:
    labels, seen = table(1, rows=200)
    order = np.random.default_rng(1).permutation(200)
    found = judge_labels({name: one[order] for name, one in labels.items()}, seen)
    assert [one.values["name"] for one in found] == ["depth_mm", "force_z_n"]
    assert str(found[0]).endswith("are the rows in another order, or of other images?")


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(["depth_mm", "tilt_x_deg", "force_z_n"]))
def test_a_column_of_one_value_is_said(seed: int, name: str) -> None:
    labels, seen = table(seed)
    labels[name] = np.where(np.isfinite(labels[name]), 1.5, np.nan)
    rows = int(np.isfinite(labels[name]).sum())
    (found,) = judge_labels(labels, seen)
    assert (found.impossible, str(found)) == (
        False,
        f"{name}: found 1.5 in all {rows} rows that have it, expected values that differ",
    )


@pytest.mark.parametrize("rows", [0, 5])
def test_few_rows_show_nothing(rows: int) -> None:
    labels = {"depth_mm": np.linspace(1, 2, rows)}
    assert judge_labels(labels, {"depth_mm": labels["depth_mm"] * 1000}) == ()
    assert judge_labels({}, {}) == ()
