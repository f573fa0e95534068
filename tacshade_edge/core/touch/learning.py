"""The touch model in closed form from a table of labelled frames: no step of descent, no random number.

Kernel width and regularisation are those with the least error on held-out groups of frames, which a linear model gives
without being fitted again ([1] eq. 5.12 for one frame, here for several): r_g = (I - H_gg)⁻¹ (y_g - ŷ_g).

References
----------
[1] C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning, MIT Press, 2006.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.core.touch.imprint import terms
from tacshade_edge.core.touch.model import (
    kernel_values,
    leverage,
    residual,
    standardised,
    unreached,
)
from tacshade_edge.types import F32, F64, I64, TouchModel

COMPONENTS = 128
CENTRES = 1000
FUNCTIONS = 350
"""Of the basis, whose variance is kept one by one. With these a model takes 3.8 MB at most in a file."""
WIDTHS = (0.7, 1.0, 1.4, 2.0, 3.0)
"""Of the kernel, in the root mean square of a frame's coordinates."""
RIDGES = np.logspace(-3, 3, 25)
LEAST_ROWS = 40
LEAST_GROUPS = 5
"""Of rows that have a quantity: a press that is held out needs others to be predicted from."""
FOLDED_ROWS = 1000
"""A larger table's frames are held out one group at a time from components that they were part of."""
FOLDS = 10
SEEN_ERRORS = 2.0
"""A held-out R² below so many standard deviations of what chance gives, 1 / √n, or below `SEEN`: it cannot be seen."""
SEEN = 0.1
Z_90 = 1.645
ANOTHER = 3.0
"""An imprint is another object's beyond so many times what the squared distance of 95 in 100 held-out ones reaches: so
few that a torn map in the table does not widen it."""
IMPRINT_RIDGE = 3.0
LEAST_DEVIATION = 1e-3
"""Of an imprint's number over the table, in mm, and of a held-out one's variance, in parts of the table's."""
UNLIKE = 1.5
"""A frame is unlike the table beyond so many times what 99 of 100 held-out frames of it reach."""
CONTRADICTS = 5.0
"""A row whose held-out residual is beyond so many robust standard deviations contradicts the others."""


@dataclass(frozen=True, slots=True)
class QuantityReport:
    """How well held-out frames are answered.

    Attributes
    ----------
    name : str
    rows : int
        With a label.
    error : float
        Mean absolute error.
    r2 : float
    coverage_90 : float
        Part of the labels in the 90 % interval.
    error_twice, error_four_times : float
        To expect with twice and four times the labels, by the error's power law in their number.
    seen : bool
        Whether the model answers it.
    contradicting : tuple of int
        Rows that contradict the others.
    """

    name: str
    rows: int
    error: float
    r2: float
    coverage_90: float
    error_twice: float
    error_four_times: float
    seen: bool
    contradicting: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LearntTouch:
    """A model (None where no quantity is seen) and what it is worth."""

    model: TouchModel | None
    reports: tuple[QuantityReport, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Space:
    """Principal components of a table's standardised features, and its frames' coordinates in them."""

    mean: F32
    deviation: F32
    components: F32
    scale: float
    at: F64

    @property
    def spread(self) -> F32:
        made: F32 = np.maximum(self.at.std(axis=0), 1e-9).astype(np.float32)
        return made


@dataclass(frozen=True, slots=True, eq=False)
class _Basis:
    """Functions of the coordinates that are uncorrelated over the table.

    `values` is (n, K), its squares add to `power` (K,); `unreached` (n,) is what the centres leave of the kernel.
    """

    width: float
    centres: F64
    matrix: F64
    values: F64
    power: F64
    unreached: F64


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """One quantity's weights, and of each labelled row the held-out residual and variance, in parts of the noise's.

    The variance is NaN where it says nothing of other frames.
    """

    rows: I64
    ridge: float
    offset: float
    weights: F64
    residuals: F64
    variances: F64

    @property
    def noise(self) -> float:
        """A label's standard deviation about the model, such that the 90 % interval holds 90 % of held-out rows."""
        return max(float(np.nanquantile(np.abs(self.residuals) / np.sqrt(1 + self.variances), 0.9)) / Z_90, 1e-9)


@dataclass(frozen=True, slots=True, eq=False)
class _Imprint:
    """See `TouchModel.imprint_weights`, `imprint_precision` and `imprint_max`."""

    weights: F64
    precision: F64
    most: float


def learn(features: F32, imprints: F32, names: Sequence[str], labels: F64, groups: I64, networks: str) -> LearntTouch:
    """Learn a touch model.

    Parameters
    ----------
    features : float32 (n, D)
    imprints : float32 (n, I)
        See `imprint_of`.
    names : sequence of str
        Of the quantities.
    labels : float64 (n, Q)
        NaN where a frame has none; each quantity has `LEAST_ROWS` or more, in `LEAST_GROUPS` or more.
    groups : int64 (n,)
        Frames of one press have one number: they are held out together.
    networks : str
        See `TouchModel`.
    """
    space = _space(features)
    tried = []
    for width in WIDTHS:
        basis = _basis(space.at, width)
        solved = [_solve(basis, labels[:, q], groups) for q in range(len(names))]
        errors = [np.mean(one.residuals**2) / _variance(labels[one.rows, q]) for q, one in enumerate(solved)]
        tried.append((float(np.mean(errors)), basis, solved))
    _, basis, solved = min(tried, key=lambda one: one[0])
    limits, solved = _judged(features, labels, groups, basis.width, solved)
    if len(features) > FOLDED_ROWS:
        solved = [_as_others(basis, space.at, one) for one in solved]
    # A frame of the table itself is like the table.
    own = float(leverage(space.at, space.spread.astype(np.float64)).max())
    reports = tuple(_report(name, basis, labels[:, q], groups, solved[q]) for q, name in enumerate(names))
    kept = [q for q, report in enumerate(reports) if report.seen]
    if not kept:
        return LearntTouch(None, reports)
    parts = [len(solved[q].rows) / len(features) for q in kept]
    low, high = (ends(labels[:, kept], axis=0).astype(np.float32) for ends in (np.nanmin, np.nanmax))
    values = np.stack([_held_out_values(basis, labels[:, q], solved[q]) for q in kept], axis=1)
    imprint = _imprint(imprints.astype(np.float64), terms(values, low, high), groups)
    model = TouchModel(
        names=tuple(names[q] for q in kept),
        networks=networks,
        mean=space.mean,
        deviation=space.deviation,
        components=space.components,
        scale=space.scale,
        spread=space.spread,
        centres=basis.centres.astype(np.float32),
        width=basis.width,
        basis=basis.matrix[:, -FUNCTIONS:].astype(np.float32),
        weights=np.stack([basis.matrix @ solved[q].weights for q in kept], axis=1).astype(np.float32),
        precision=np.stack(
            [1 / (basis.power[-FUNCTIONS:] * part + solved[q].ridge) for q, part in zip(kept, parts, strict=True)],
            axis=1,
        ).astype(np.float32),
        ridge=np.array([solved[q].ridge for q in kept], np.float32),
        offset=np.array([solved[q].offset for q in kept], np.float32),
        noise=np.array([solved[q].noise for q in kept], np.float32),
        low=low,
        high=high,
        leverage_max=max(limits[0], 1.01 * own),
        residual_max=limits[1],
        imprint_weights=imprint.weights.astype(np.float32),
        imprint_precision=imprint.precision.astype(np.float32),
        imprint_max=imprint.most,
    )
    return LearntTouch(model, reports)


def _variance(labels: F64) -> float:
    """Above 0 also where all labels are the same."""
    return max(float(np.var(labels)), 1e-12)


def _space(features: F32) -> _Space:
    mean, deviation = features.mean(axis=0), features.std(axis=0)
    deviation = deviation + np.float32(1e-3) * np.float32(features.std()) + np.float32(1e-6)
    standard = standardised(features, mean, deviation)
    rows, columns = standard.shape
    count = min(COMPONENTS, rows - 2, columns)
    if rows <= columns:
        _, vectors = np.linalg.eigh((standard @ standard.T).astype(np.float64))
        components = standard.T @ vectors[:, : -count - 1 : -1].astype(np.float32)
        components /= np.maximum(np.linalg.norm(components, axis=0), np.float32(1e-12))
    else:
        _, vectors = np.linalg.eigh((standard.T @ standard).astype(np.float64))
        components = vectors[:, : -count - 1 : -1].astype(np.float32)
    at = standard @ components
    scale = float(np.sqrt((at.astype(np.float64) ** 2).sum(axis=1).mean())) or 1.0
    # Stored in 16 bits, and so rounded before anything is learnt from them.
    components = (components / np.float32(scale)).astype(np.float16).astype(np.float32)
    return _Space(mean, deviation, components, scale, (standard @ components).astype(np.float64))


def _centre_rows(rows: int) -> I64:
    return np.linspace(0, rows - 1, min(CENTRES, rows)).astype(np.int64)


def _basis(at: F64, width: float) -> _Basis:
    centres = at[_centre_rows(len(at))]
    parts = at.shape[1]
    power, turned = np.linalg.eigh(kernel_values(centres, centres, width)[:, parts:])
    keep = power > 1e-6 * power[-1]
    # The centres' functions as a Gaussian process weighs them: K_zz^(-1/2).
    matrix = np.zeros((parts + len(centres), parts + int(keep.sum())))
    matrix[:parts, :parts] = np.eye(parts)
    matrix[parts:, parts:] = turned[:, keep] / np.sqrt(power[keep])
    values = kernel_values(at, centres, width) @ matrix
    powers, turned = np.linalg.eigh(values.T @ values)
    values = values @ turned
    return _Basis(width, centres, matrix @ turned, values, np.maximum(powers, 0), unreached(at, values))


def _solve(basis: _Basis, labels: F64, groups: I64) -> _Solved:
    """Least squares with the ridge that held-out groups ask for."""
    rows = np.flatnonzero(np.isfinite(labels))
    some = len(rows) < len(basis.values)
    values, power = basis.values[rows], basis.power
    if some:
        power, turned = np.linalg.eigh(values.T @ values)
        power, values = np.maximum(power, 0), values @ turned
    offset = float(labels[rows].mean())
    left = labels[rows] - offset
    at = values.T @ left
    best: tuple[float, float, F64, F64] | None = None
    for ridge in RIDGES:
        residuals, variances = _held_out(values, 1 / (power + ridge), left, at, groups[rows])
        variances = variances + basis.unreached[rows] / ridge
        error = float(np.mean(residuals**2))
        if best is None or error < best[0]:
            best = (error, float(ridge), residuals, variances)
    assert best is not None
    weights = at / (power + best[1])
    return _Solved(rows, best[1], offset, turned @ weights if some else weights, best[2], best[3])


def _as_others(basis: _Basis, at: F64, solved: _Solved) -> _Solved:
    """With the variances that the model gives frames that it does not know: those of rows that are no centres."""
    values = basis.values[solved.rows][:, -FUNCTIONS:]
    precision = 1 / (basis.power[-FUNCTIONS:] * len(solved.rows) / len(at) + solved.ridge)
    variances = (values * values) @ precision + unreached(at[solved.rows], values) / solved.ridge
    variances[np.isin(solved.rows, _centre_rows(len(at)))] = np.nan
    return replace(solved, variances=variances)


def _held_out(values: F64, inverse: F64, left: F64, at: F64, groups: I64) -> tuple[F64, F64]:
    """Residuals and variances of the rows, each predicted by the other groups."""
    weighted = values * inverse
    residuals = left - weighted @ at
    own = (weighted * values).sum(axis=1) + 1 / len(values)
    order = np.argsort(groups, kind="stable")
    starts = np.flatnonzero(np.diff(groups[order], prepend=groups[order[0]] - 1))
    held = residuals / np.maximum(1 - own, 1e-6)
    variances = own / np.maximum(1 - own, 1e-6)
    for rows in np.split(order, starts[1:]):
        if len(rows) > 1:
            hat = weighted[rows] @ values[rows].T + 1 / len(values)
            without = np.linalg.inv(np.eye(len(rows)) * (1 + 1e-6) - hat)
            held[rows] = without @ residuals[rows]
            variances[rows] = np.maximum((hat @ without).diagonal(), 0)
    return held, variances


def _held_out_values(basis: _Basis, labels: F64, solved: _Solved) -> F64:
    """What the other groups answer for each labelled row, and the model for the rest."""
    values = solved.offset + basis.values @ solved.weights
    values[solved.rows] = labels[solved.rows] - solved.residuals
    return values


def _imprint(imprints: F64, values: F64, groups: I64) -> _Imprint:
    """Least squares from the quantities' terms, (n, T), and how far held-out groups are off."""
    mean, deviation = imprints.mean(axis=0), np.maximum(imprints.std(axis=0), LEAST_DEVIATION)
    standard = (imprints - mean) / deviation
    power, turned = np.linalg.eigh(values.T @ values)
    values, inverse = values @ turned, 1 / (np.maximum(power, 0) + IMPRINT_RIDGE)
    at = values.T @ standard
    off = np.stack(
        [_held_out(values, inverse, *each, groups)[0] for each in zip(standard.T, at.T, strict=True)], axis=1
    )
    weights = turned @ (inverse[:, None] * at) * deviation
    weights[0] += mean
    covariance = off.T @ off / len(off) + LEAST_DEVIATION * np.eye(off.shape[1])
    precision = np.linalg.inv(covariance) / off.shape[1]
    distances = ((off @ precision) * off).sum(axis=1)
    most = max(ANOTHER * float(np.quantile(distances, 0.95)), 1e-6)
    return _Imprint(weights, precision / np.outer(deviation, deviation), most)


def _report(name: str, basis: _Basis, labels: F64, groups: I64, solved: _Solved) -> QuantityReport:
    residuals = np.abs(solved.residuals)
    known = labels[solved.rows]
    error, r2 = float(residuals.mean()), 1 - float(np.mean(residuals**2)) / _variance(known)
    robust = 1.4826 * float(np.median(residuals))
    seen = r2 >= max(SEEN, SEEN_ERRORS / float(np.sqrt(len(known))))
    exponent = _exponent(basis, labels, groups, error)
    return QuantityReport(
        name=name,
        rows=len(solved.rows),
        error=error,
        r2=r2,
        coverage_90=_coverage(residuals / np.sqrt(1 + solved.variances)),
        error_twice=error * 2**-exponent,
        error_four_times=error * 4**-exponent,
        seen=seen,
        contradicting=tuple(int(row) for row in solved.rows[residuals > CONTRADICTS * robust]) if seen else (),
    )


def _coverage(scaled: F64) -> float:
    """How many residuals of each half the interval by the other half's holds."""
    scaled = scaled[np.isfinite(scaled)]
    halves = scaled[::2], scaled[1::2]
    return float(np.mean([np.mean(a <= np.quantile(b, 0.9)) for a, b in (halves, halves[::-1])]))


def _exponent(basis: _Basis, labels: F64, groups: I64, error: float) -> float:
    """P of error ~ 1 / n^p, from this table and half of its groups; 0 to 0.5, no more than noise that averages out."""
    half = np.where(np.isin(groups, np.unique(groups)[::2]), labels, np.nan)
    if np.isfinite(half).sum() < LEAST_ROWS // 2:
        return 0.0
    residuals = np.abs(_solve(basis, half, groups).residuals)
    return float(np.clip(np.log2(max(residuals.mean(), 1e-12) / max(error, 1e-12)), 0, 0.5))


def _judged(
    features: F32, labels: F64, groups: I64, width: float, solved: Sequence[_Solved]
) -> tuple[tuple[float, float], list[_Solved]]:
    """The greatest leverage and residual of frames like the table's; residuals and variances of a small table's rows.

    Both are of frames that were held out before the components were found, which few frames describe too well.
    """
    chosen = np.linspace(0, len(features) - 1, min(FOLDED_ROWS, len(features))).astype(int)
    whole = len(chosen) == len(features)
    fold = np.unique(groups[chosen], return_inverse=True)[1] % FOLDS
    found: list[tuple[F64, F64]] = []
    held_out = [(np.full(len(features), np.nan), np.full(len(features), np.nan)) for _ in solved]
    for part in range(FOLDS):
        held, rest = chosen[fold == part], chosen[fold != part]
        if not len(held) or len(rest) < LEAST_ROWS // 2:
            continue
        space = _space(features[rest])
        standard = standardised(features[held], space.mean, space.deviation)
        at = (standard @ space.components).astype(np.float64)
        residuals = residual(standard.astype(np.float64), at, space.scale)
        found.append((leverage(at, space.spread.astype(np.float64)), residuals))
        if whole:
            basis = _basis(space.at, width)
            values = kernel_values(at, basis.centres, width) @ basis.matrix
            for q, one in enumerate(solved):
                if not np.isfinite(labels[rest, q]).any():
                    continue
                residuals, variances = _of_fold(basis, labels[rest, q], values, at, one.ridge)
                held_out[q][0][held], held_out[q][1][held] = labels[held, q] - residuals, variances
    limits = [max(UNLIKE * float(np.quantile(np.concatenate(each), 0.99)), 1e-6) for each in zip(*found, strict=True)]
    if not whole:
        return (limits[0], limits[1]), list(solved)
    # A fold may hold out every row that has a quantity: then what `_solve` found stands.
    folded = [
        (residuals[one.rows], variances[one.rows]) for one, (residuals, variances) in zip(solved, held_out, strict=True)
    ]
    return (limits[0], limits[1]), [
        replace(one, residuals=residuals, variances=variances) if np.isfinite(residuals).all() else one
        for one, (residuals, variances) in zip(solved, folded, strict=True)
    ]


def _of_fold(basis: _Basis, labels: F64, values: F64, at: F64, ridge: float) -> tuple[F64, F64]:
    """Predictions and their variances, in parts of the noise's, of frames that the fold's rows do not hold."""
    some = np.isfinite(labels)
    rows = basis.values[some]
    inverse = np.linalg.inv(rows.T @ rows + ridge * np.eye(rows.shape[1]))
    offset = labels[some].mean()
    weights = inverse @ (rows.T @ (labels[some] - offset))
    variances = ((values @ inverse) * values).sum(axis=1) + unreached(at, values) / ridge
    return offset + values @ weights, variances
