"""Frames with labels: how well the touch follows them that the calibration's own model predicts,
in the labels' units and without a fitted line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.lab.studies.evaluate.labelled import COLUMNS, spearman
from tacshade_edge.lab.studies.markdown import markdown, number
from tacshade_edge.reasons import Reason
from tacshade_edge.types import QUANTITIES, Reconstruction

HALF_90 = 1.645
"""Half width of the 90 % interval, in standard deviations."""


@dataclass(frozen=True, slots=True)
class TouchRow:
    """A frame's label of one quantity, and its touch; NaN if the touch does not know it."""

    image: str
    profile: str
    quantity: str
    label: float
    touch: float
    sigma: float


@dataclass(frozen=True, slots=True)
class TouchAgreement:
    """How well one quantity of the touch follows its label, over frames that were not refused."""

    quantity: str
    frames: int
    unknown: int  # without a number of their own
    rank_correlation: float
    error: float  # mean absolute error of those with a number, in the quantity's unit
    held: float  # part of the labels within the 90 % intervals


def scored(quantities: Sequence[str] | Reason, columns: Sequence[str], *, learnt: bool) -> set[str]:
    """Of a table's columns, those that a profile's touch is compared with: without a model, only
    those that `labelled` does not score by a line.
    """
    if isinstance(quantities, Reason):
        return set()
    return set(columns).intersection(quantities).difference(() if learnt else COLUMNS)


def touch_rows(
    image: str, known: Mapping[str, float], names: set[str], result: Reconstruction
) -> list[TouchRow]:
    """A row for each label among `names`; none for a refused frame."""
    if result.reason:
        return []
    values = {} if result.touch is None else result.touch.values
    sigma = {} if result.touch is None else result.touch.sigma
    return [
        TouchRow(image, result.profile, name, label, _value(values, name), _value(sigma, name))
        for name, label in known.items()
        if name in names
    ]


def _value(values: Mapping[str, float | None], name: str) -> float:
    found = values.get(name)
    return math.nan if found is None else found


def touch_agreements(rows: Sequence[TouchRow]) -> list[TouchAgreement]:
    """Compare one profile's touches with the labels, quantity by quantity."""
    made = []
    for name in sorted({row.quantity for row in rows}, key=QUANTITIES.index):
        some = [row for row in rows if row.quantity == name]
        there = [row for row in some if math.isfinite(row.touch)]
        label, touch, sigma = (
            np.array([getattr(row, field) for row in there])
            for field in ("label", "touch", "sigma")
        )
        off = np.abs(touch - label)
        few = not len(there)
        made.append(
            TouchAgreement(
                name,
                len(some),
                len(some) - len(there),
                spearman(touch, label) if len(there) > 1 else math.nan,
                math.nan if few else float(off.mean()),
                math.nan if few else float(np.mean(off <= HALF_90 * sigma)),
            )
        )
    return made


def unscored(
    columns: Sequence[str], profile: str, quantities: Sequence[str] | Reason, names: set[str]
) -> list[str]:
    """A line for each column that nothing is compared with, or one for a model that cannot be
    used.
    """
    if isinstance(quantities, Reason):
        return [f"{profile}: labels are not compared with a touch: {quantities}"]
    return [
        f"{name}: not scored: the calibration's {profile} has not learnt it; "
        f"`calibrate --labels` learns it from frames"
        for name in columns
        if name not in names and name not in COLUMNS
    ]


def touch_text(made: Mapping[str, Sequence[TouchAgreement]]) -> str:
    """A table for people; empty if no touch was compared."""
    lines = [
        (
            profile,
            one.quantity,
            str(one.frames),
            str(one.unknown),
            number(one.rank_correlation, ".2f"),
            number(one.error, ".3f"),
            number(100 * one.held, ".0f"),
        )
        for profile, some in made.items()
        for one in some
    ]
    if not lines:
        return ""
    header = (
        "profile",
        "touch",
        "frames",
        "unknown",
        "rank correlation",
        "mean error",
        "90 % intervals hold %",
    )
    return markdown(header, lines)
