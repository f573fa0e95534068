"""Hold out folds of a table before the directions are found (in a small table, before the
components), because these fit few frames too well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.sensor.touch.components import Components, Table, components_of
from tacshade_edge.sensor.touch.regression import (
    FUNCTIONS,
    Basis,
    BasisFit,
    Solved,
    basis_of,
    metric_of,
    precision_of,
    solve,
)
from tacshade_edge.sensor.touch.touch_answer import (
    coordinates,
    kernel,
    leverage,
    residual,
    scaled,
    unreached,
)
from tacshade_edge.types import F64, Bool

LEAST_ROWS = 40
FOLDED_ROWS = 1000
"""In a larger table, held-out frames are not left out of the components."""
FOLDS = 10
FOLDS_OF_MANY = 3
"""That are tried in a larger table."""
UNLIKE = 1.5
"""A frame is unlike the table beyond this multiple of the 99th percentile of held-out frames."""
_OWN = 1.01  # times the greatest leverage of the table: its own frames belong


@dataclass(frozen=True, slots=True)
class Limits:
    """Greatest leverage and residual of a frame like the table's (`TouchModel`)."""

    leverage: float
    residual: float


def judged(
    table: Table, known: Components, first: BasisFit, second: BasisFit
) -> tuple[Limits, list[Solved]]:
    """Limits for frames like the table's, and the second fit with the values of held-out folds."""
    whole = len(table.features) <= FOLDED_ROWS
    # By groups, so that no press lies on both sides of a fold.
    fold = np.unique(table.groups, return_inverse=True)[1] % FOLDS
    found: list[tuple[F64, F64]] = []
    answers = [np.full((2, len(table.features)), np.nan) for _ in second.solved]
    for part in range(FOLDS if whole else FOLDS_OF_MANY):
        held, rest = fold == part, fold != part
        if not held.any() or rest.sum() < LEAST_ROWS // 2:
            continue
        of_rest = (
            components_of(table.features[rest], table.changed_parts[rest])
            if whole
            else replace(known, at=known.at[rest])
        )
        unlike, new = _seen_by(of_rest, table, held)
        found.append(unlike)
        for q, answer in _answered(of_rest, new, (table, rest), first, second).items():
            answers[q][:, held] = answer
    most = [
        max(UNLIKE * float(np.quantile(np.concatenate(each), 0.99)), 1e-6)
        for each in zip(*found, strict=True)
    ]
    own = _OWN * float(leverage(known.at, known.spread).max())
    solved = [
        _with_answers(one, table.labels[:, q], answers[q], whole=whole)
        for q, one in enumerate(second.solved)
    ]
    return Limits(max(most[0], own), most[1]), solved


def _seen_by(known: Components, table: Table, held: Bool) -> tuple[tuple[F64, F64], F64]:
    """Leverage and residual of held-out frames, and their coordinates."""
    standard = scaled(table.features[held], known.mean, known.deviation)
    at = (standard @ known.components).astype(np.float64)
    residuals = residual(standard.astype(np.float64), at, known.scale)
    return (leverage(at, known.spread), residuals), coordinates(at, known.origin)


def _answered(
    known: Components,
    new: F64,
    table_and_rest: tuple[Table, Bool],
    first: BasisFit,
    second: BasisFit,
) -> dict[int, tuple[F64, F64]]:
    """Predictions and their variances at held-out coordinates, from the rest of the table, by
    quantity, with the widths and ridges of both fits.
    """
    table, rest = table_and_rest
    labels, groups = table.labels[rest], table.groups[rest]
    some = [q for q in range(labels.shape[1]) if np.isfinite(labels[:, q]).any()]
    own = coordinates(known.at, known.origin)
    basis = basis_of(own, first.basis.width)
    solved = [solve(basis, labels[:, q], groups, first.solved[q].ridge) for q in some]
    metric = metric_of(BasisFit(basis, solved), own, labels[:, some])
    basis = basis_of(own @ metric, second.basis.width)
    values = kernel(new @ metric, basis.centres, basis.width) @ basis.matrix
    return {
        q: _of_fold(basis, labels[:, q], values, new @ metric, second.solved[q].ridge) for q in some
    }


def _of_fold(basis: Basis, labels: F64, values: F64, at: F64, ridge: float) -> tuple[F64, F64]:
    """Predictions for held-out frames, and their variances relative to the noise."""
    some = np.isfinite(labels)
    rows = basis.values[some]
    inverse = np.linalg.inv(rows.T @ rows + ridge * np.eye(rows.shape[1]))
    offset = labels[some].mean()
    weights = inverse @ (rows.T @ (labels[some] - offset))
    few = values[:, -FUNCTIONS:]  # as `predict` knows them
    variances = (few * few) @ precision_of(basis, len(rows), ridge) + unreached(at, few) / ridge
    return offset + values @ weights, variances


def _with_answers(one: Solved, labels: F64, answers: F64, *, whole: bool) -> Solved:
    values, variances = answers[:, one.rows]
    # A fold may hold out every row with a quantity: then keep the values from `solve`.
    finite = np.isfinite(values)
    if not (finite.all() or (finite.any() and not whole)):
        return one
    residuals = np.where(finite, labels[one.rows] - values, one.residuals)
    return replace(one, residuals=residuals, variances=variances)
