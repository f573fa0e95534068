"""Labels of honest tables and in other units, against a map that is off and trembles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.plausibility.label_columns import judge_labels
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


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([(1, "before"), (-1, "after")]))
def test_a_table_shifted_by_a_row_is_refused(seed: int, case: tuple[int, str]) -> None:
    labels, seen = table(seed)
    by, row = case
    found = judge_labels({name: np.roll(one, by) for name, one in labels.items()}, seen)
    assert [(one.code, one.values["row"]) for one in found] == [(SuspicionCode.LABELS_SHIFTED, row)]


@pytest.mark.parametrize("rows", [0, 5])
def test_few_rows_show_nothing(rows: int) -> None:
    labels = {"depth_mm": np.linspace(1, 2, rows)}
    assert judge_labels(labels, {"depth_mm": labels["depth_mm"] * 1000}) == ()
    assert judge_labels({}, {}) == ()
