"""Learn the touch model in closed form from a table of labelled frames:
no gradient descent, no random numbers.

Kernel width and regularisation minimise the error on held-out groups of frames, which a linear
model gives without another fit (Rasmussen and Williams, 2006, eq. 5.12, here for several): r_g =
(I - H_gg)⁻¹ (y_g - ŷ_g).

Most components show nothing of the quantities. A first fit finds the directions along which its
answers change, by the mean outer product of their gradients; the second fit sees these, each scaled
by the square root of that change (one step of Radhakrishnan, Beaglehole, Pandit and Belkin, Science
383, 2024).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.sensor.touch.touch_answer import (
    LINEAR,
    coordinates,
    kernel,
    leverage,
    residual,
    scaled,
    terms,
    unreached,
)
from tacshade_edge.types import F32, F64, I64, TouchModel

COMPONENTS = 96
DIRECTIONS = 32  # of the components, in which the quantities change
LEAST_CHANGE = 1e-4  # added to a direction's mean squared gradient, relative to the greatest
CENTRES = 1000
FUNCTIONS = (
    128  # basis functions with an individual variance: a model takes at most 1.6 MB in a file
)
WIDTHS = (
    0.7,
    1.0,
    1.4,
    2.0,
    3.0,
)  # kernel widths to try, relative to the root mean square of a frame's coordinates
RIDGES = np.logspace(-3, 3, 25)
LEAST_ROWS = 40
LEAST_GROUPS = (
    5  # least number of groups with a quantity: the prediction of a held-out press needs others
)
FOLDED_ROWS = 1000  # in a larger table, held-out frames are not left out of the components
FOLDS = 10
FOLDS_OF_MANY = 3  # that are tried in a larger table
UNTOUCHED = 0.03  # share of the frames, the least changed, whose mean stands for the untouched skin
GATE_QUANTILE, GATE_SHARE = 0.01, 0.8
"""The model answers a frame that has changed by at least this share
of this quantile over the table.
"""
# Least held-out R² of a seen quantity, in deviations of chance, 1 / √n; also at least `SEEN`.
SEEN_ERRORS = 2.0
SEEN = 0.1
Z_90 = 1.645
# An imprint is another object's beyond this multiple
# of held-out squared distances' 95th percentile,.
ANOTHER = 5.0
# and beyond `UNLIKE` times their 99.5th
IMPRINT_RIDGE = 3.0
# Of an imprint's number over the table, in mm, and of held-out variance relative to the table's.
LEAST_DEVIATION = 1e-3
# a frame is unlike the table beyond this multiple of the 99th percentile of held-out frames.
UNLIKE = 1.5
# a row contradicts the others if its held-out residual exceeds this many robust standard
# deviations.
CONTRADICTS = 5.0


@dataclass(frozen=True, slots=True)
class QuantityReport:
    """The quality of the answers for held-out frames."""

    name: str
    rows: int  # with a label
    error: float  # mean absolute
    r2: float
    coverage_90: float  # part of the labels in the 90 % interval
    seen: bool  # the model answers the quantity
    contradicting: tuple[int, ...]  # rows


@dataclass(frozen=True, slots=True, eq=False)
class LearntTouch:
    """A model (None if no quantity is seen) and its quality."""

    model: TouchModel | None
    reports: tuple[QuantityReport, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Space:
    """A table's principal components, its frames' coordinates in them (`at`),
    and the untouched skin's (`origin`).
    """

    mean: F32
    deviation: F32
    components: F32
    scale: float
    at: F64
    spread: F32
    origin: F32


@dataclass(frozen=True, slots=True, eq=False)
class _Basis:
    """Functions (n, K), uncorrelated over the table, sums of their squares,
    and the variance beyond the centres.
    """

    width: float
    centres: F64
    matrix: F64
    values: F64
    power: F64
    unreached: F64


@dataclass(frozen=True, slots=True, eq=False)
class _Solved:
    """One quantity's weights, and each labelled row's held-out residual and its variance relative
    to the noise (NaN if the row was not left out of the directions).
    """

    rows: I64
    ridge: float
    offset: float
    weights: F64
    residuals: F64
    variances: F64

    @property
    def noise(self) -> float:
        """Standard deviation of a label about the model for which the 90 % interval holds 90 %
        of held-out rows.
        """
        return max(
            float(np.nanquantile(np.abs(self.residuals) / np.sqrt(1 + self.variances), 0.9)) / Z_90,
            1e-9,
        )


_Fit = tuple[_Basis, list[_Solved]]


def learn(
    features: F32,
    imprints: F32,
    changed_parts: F64,
    names: Sequence[str],
    labels: F64,
    groups: I64,
    networks: str,
) -> LearntTouch:
    """Learn a touch model from features (n, D), imprints (n, I), NaN without contact, changed parts
    of the picture (n,), and labels (n, Q), NaN if a frame has none; each quantity has at least
    `LEAST_ROWS`, in at least `LEAST_GROUPS` groups. Frames of one press share a group, held out
    together.
    """
    space = _space(features, changed_parts)
    whole = coordinates(space.at, space.origin)
    first = _fitted(whole, labels, groups)
    metric = _metric(first, whole, labels)
    basis, solved = second = _fitted(whole @ metric, labels, groups)
    (leverage_max, residual_max), solved = _judged(
        features, changed_parts, labels, groups, space, first, second
    )
    reports = tuple(_report(name, labels[:, q], solved[q]) for q, name in enumerate(names))
    kept = [q for q, report in enumerate(reports) if report.seen]
    if not kept:
        return LearntTouch(None, reports)
    low, high = (
        ends(labels[:, kept], axis=0).astype(np.float32) for ends in (np.nanmin, np.nanmax)
    )
    chosen = [solved[q] for q in kept]
    # Predictions from the other groups for each labelled row, and from the model for the rest.
    values = np.stack([one.offset + basis.values @ one.weights for one in chosen], axis=1)
    for k, (q, one) in enumerate(zip(kept, chosen, strict=True)):
        values[one.rows, k] = labels[one.rows, q] - one.residuals
    touching = np.isfinite(imprints[:, 0])
    imprinted = imprints[touching].astype(np.float64)
    weights, precision, most = _imprint(
        imprinted, terms(values[touching], low, high), groups[touching]
    )
    model = TouchModel(
        names=tuple(names[q] for q in kept),
        networks=networks,
        mean=space.mean,
        deviation=space.deviation,
        components=space.components,
        scale=space.scale,
        spread=space.spread,
        origin=space.origin,
        metric=metric.astype(np.float32),
        gate_part=GATE_SHARE * float(np.quantile(changed_parts, GATE_QUANTILE)),
        centres=basis.centres.astype(np.float32),
        width=basis.width,
        basis=basis.matrix[:, -FUNCTIONS:].astype(np.float32),
        weights=np.stack([basis.matrix @ one.weights for one in chosen], axis=1).astype(np.float32),
        precision=np.stack(
            [_precision(basis, len(one.rows), one.ridge) for one in chosen], axis=1
        ).astype(np.float32),
        ridge=np.array([one.ridge for one in chosen], np.float32),
        offset=np.array([one.offset for one in chosen], np.float32),
        noise=np.array([one.noise for one in chosen], np.float32),
        low=low,
        high=high,
        leverage_max=max(
            leverage_max, 1.01 * float(leverage(space.at, space.spread).max())
        ),  # the table's own belong
        residual_max=residual_max,
        imprint_weights=weights.astype(np.float32),
        imprint_precision=precision.astype(np.float32),
        imprint_max=most,
    )
    return LearntTouch(model, reports)


def _fitted(at: F64, labels: F64, groups: I64) -> _Fit:
    """The fit of the kernel width with the least held-out error."""

    def tried(width: float) -> tuple[float, _Basis, list[_Solved]]:
        basis = _basis(at, width)
        solved = [_solve(basis, column, groups) for column in labels.T]
        # Logarithms, so that a quantity that no frame shows chooses nothing.
        return (
            float(np.mean([np.log(np.abs(one.residuals).mean() + 1e-300) for one in solved])),
            basis,
            solved,
        )

    return min(map(tried, WIDTHS), key=lambda one: one[0])[1:]  # holds two fits at a time, not all


def _metric(fit: _Fit, at: F64, labels: F64) -> F64:
    """The directions (m, n) of coordinates in which a fit's answers change,
    so that coordinates keep their length.
    """
    basis, solved = fit
    size = at.shape[1]
    near = kernel(at, basis.centres, basis.width)[:, size:]
    changes = np.zeros((size, size))
    for q, one in enumerate(solved):
        weights = basis.matrix @ one.weights
        pull = near * weights[size:]
        slopes = (
            pull @ basis.centres - pull.sum(axis=1)[:, None] * at
        ) / basis.width**2 + LINEAR * weights[:size]
        changes += slopes.T @ slopes / _variance(labels[one.rows, q])
    power, turned = np.linalg.eigh(changes)
    scale = (np.maximum(power, 0) / max(power[-1], 1e-300) + LEAST_CHANGE) ** 0.25
    metric: F64 = (turned * scale)[:, : -DIRECTIONS - 1 : -1]
    metric /= np.sqrt(((at @ metric) ** 2).sum(axis=1).mean()) or 1.0
    return metric.astype(np.float32).astype(np.float64)


def _variance(labels: F64) -> float:
    """Variance of the labels, above 0 even if all are equal."""
    return max(float(np.var(labels)), 1e-12)


def _space(features: F32, changed_parts: F64) -> _Space:
    mean, deviation = features.mean(axis=0), features.std(axis=0)
    deviation = deviation + np.float32(1e-3) * np.float32(features.std()) + np.float32(1e-6)
    standard = scaled(features, mean, deviation)
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
    # Rounded first, because the file stores 16 bits.
    components = (components / np.float32(scale)).astype(np.float16).astype(np.float32)
    at = standard @ components
    origin = at[np.argsort(changed_parts)[: math.ceil(UNTOUCHED * rows)]].mean(axis=0)
    spread = np.maximum(at.std(axis=0, dtype=np.float64), 1e-9).astype(np.float32)
    return _Space(mean, deviation, components, scale, at.astype(np.float64), spread, origin)


def _basis(at: F64, width: float) -> _Basis:
    centres = at[np.linspace(0, len(at) - 1, min(CENTRES, len(at))).astype(np.int64)]
    parts = at.shape[1]
    power, turned = np.linalg.eigh(kernel(centres, centres, width)[:, parts:])
    keep = power > 1e-6 * power[-1]
    # The centres' functions with the weights of a Gaussian process: K_zz^(-1/2).
    matrix = np.zeros((parts + len(centres), parts + int(keep.sum())))
    matrix[:parts, :parts] = np.eye(parts)
    matrix[parts:, parts:] = turned[:, keep] / np.sqrt(power[keep])
    values = kernel(at, centres, width) @ matrix
    powers, turned = np.linalg.eigh(values.T @ values)
    values = values @ turned
    return _Basis(
        width, centres, matrix @ turned, values, np.maximum(powers, 0), unreached(at, values)
    )


def _solve(basis: _Basis, labels: F64, groups: I64, ridge: float | None = None) -> _Solved:
    """Solve by least squares, without a ridge with that of least held-out error."""
    rows = np.flatnonzero(np.isfinite(labels))
    some = len(rows) < len(basis.values)
    values, power = basis.values[rows], basis.power
    if some:
        power, turned = np.linalg.eigh(values.T @ values)
        power, values = np.maximum(power, 0), values @ turned
    offset = float(labels[rows].mean())
    left, squares = labels[rows] - offset, values * values
    at = values.T @ left
    ridges = RIDGES if ridge is None else np.array([ridge])
    residuals, variances = _held_out(
        values, squares, 1 / (power[:, None] + ridges), left, at, groups[rows]
    )
    best = int(np.argmin(np.abs(residuals).mean(axis=0)))
    ridge = float(ridges[best])
    weights = at / (power + ridge)
    variances = variances[:, best] + basis.unreached[rows] / ridge
    return _Solved(
        rows, ridge, offset, turned @ weights if some else weights, residuals[:, best], variances
    )


def _precision(basis: _Basis, rows: int, ridge: float) -> F64:
    """Variance of the weight of each of the basis functions that vary most,
    relative to the noise.
    """
    return np.asarray(1 / (basis.power[-FUNCTIONS:] * (rows / len(basis.values)) + ridge))


def _held_out(
    values: F64, squares: F64, inverse: F64, left: F64, at: F64, groups: I64
) -> tuple[F64, F64]:
    """Residuals and variances (n, R) of the rows, each predicted from the other groups,
    by R inverses (K, R).
    """
    residuals = left[:, None] - values @ (inverse * at[:, None])
    own = squares @ inverse + 1 / len(values)
    order = np.argsort(groups, kind="stable")
    starts = np.flatnonzero(np.diff(groups[order], prepend=groups[order[0]] - 1))
    held, variances = (each / np.maximum(1 - own, 1e-6) for each in (residuals, own))
    for rows in np.split(order, starts[1:]):
        if len(rows) > 1:
            hat = (values[rows] * inverse.T[:, None]) @ values[rows].T + 1 / len(values)
            without = np.linalg.inv(np.eye(len(rows)) * (1 + 1e-6) - hat)
            held[rows] = np.einsum("rij,jr->ir", without, residuals[rows])
            variances[rows] = np.maximum(np.einsum("rij,rji->ir", hat, without), 0)
    return held, variances


def _imprint(imprints: F64, values: F64, groups: I64) -> tuple[F64, F64, float]:
    """Fit the imprint by least squares from the quantities' terms, (n, T), with the errors of
    held-out groups: weights, precision and greatest distance of the model
    (`TouchModel.imprint_weights` and the next).
    """
    if not len(imprints):  # any imprint belongs
        count = imprints.shape[1]
        return np.zeros((values.shape[1], count)), np.zeros((count, count)), 1.0
    mean, deviation = imprints.mean(axis=0), np.maximum(imprints.std(axis=0), LEAST_DEVIATION)
    standard = (imprints - mean) / deviation
    power, turned = np.linalg.eigh(values.T @ values)
    values, inverse = values @ turned, 1 / (np.maximum(power, 0)[:, None] + IMPRINT_RIDGE)
    at = values.T @ standard
    held = [
        _held_out(values, values**2, inverse, *each, groups)[0]
        for each in zip(standard.T, at.T, strict=True)
    ]
    off = np.concatenate(held, axis=1)
    weights = turned @ (inverse * at) * deviation
    weights[0] += mean
    covariance = off.T @ off / len(off) + LEAST_DEVIATION * np.eye(off.shape[1])
    precision = np.linalg.inv(covariance) / off.shape[1]
    distances = ((off @ precision) * off).sum(axis=1)
    at_95, at_995 = np.quantile(distances, (0.95, 0.995)).tolist()
    most = max(ANOTHER * at_95, UNLIKE * at_995, 1e-6)
    return weights, precision / np.outer(deviation, deviation), most


def _report(name: str, labels: F64, solved: _Solved) -> QuantityReport:
    residuals, known = np.abs(solved.residuals), labels[solved.rows]
    held = residuals[np.isfinite(solved.variances)]
    r2 = 1 - float(np.mean(held**2)) / _variance(known)
    seen = r2 >= max(SEEN, SEEN_ERRORS / float(np.sqrt(len(known))))
    contradicts = residuals > CONTRADICTS * 1.4826 * float(np.median(residuals))
    return QuantityReport(
        name=name,
        rows=len(solved.rows),
        error=float(held.mean()),
        r2=r2,
        coverage_90=_coverage(residuals / np.sqrt(1 + solved.variances)),
        seen=seen,
        contradicting=tuple(solved.rows[contradicts].tolist()) if seen else (),
    )


def _coverage(scaled: F64) -> float:
    """The part of each half's residuals inside the interval from the other half, averaged."""
    scaled = scaled[np.isfinite(scaled)]
    halves = scaled[::2], scaled[1::2]
    return float(np.mean([np.mean(a <= np.quantile(b, 0.9)) for a, b in (halves, halves[::-1])]))


def _judged(
    features: F32,
    changed_parts: F64,
    labels: F64,
    groups: I64,
    space: _Space,
    first: _Fit,
    second: _Fit,
) -> tuple[tuple[float, float], list[_Solved]]:
    """Limits of leverage and residual for frames like the table's, and the second fit's held-out
    values, of frames held out before the directions (and in a small table the components) were
    found, because these fit few frames too well.
    """
    whole = len(features) <= FOLDED_ROWS
    fold = np.unique(groups, return_inverse=True)[1] % FOLDS
    found: list[tuple[F64, F64]] = []
    held_out = [np.full((2, len(features)), np.nan) for _ in second[1]]
    for part in range(FOLDS if whole else FOLDS_OF_MANY):
        held, rest = fold == part, fold != part
        if not held.any() or rest.sum() < LEAST_ROWS // 2:
            continue
        known = (
            _space(features[rest], changed_parts[rest])
            if whole
            else replace(space, at=space.at[rest])
        )
        standard = scaled(features[held], known.mean, known.deviation)
        at = (standard @ known.components).astype(np.float64)
        residuals = residual(standard.astype(np.float64), at, known.scale)
        found.append((leverage(at, known.spread), residuals))
        some = [q for q in range(labels.shape[1]) if np.isfinite(labels[rest, q]).any()]
        own, new = coordinates(known.at, known.origin), coordinates(at, known.origin)
        basis = _basis(own, first[0].width)
        solved = [_solve(basis, labels[rest, q], groups[rest], first[1][q].ridge) for q in some]
        metric = _metric((basis, solved), own, labels[rest][:, some])
        basis = _basis(own @ metric, second[0].width)
        values = kernel(new @ metric, basis.centres, basis.width) @ basis.matrix
        for q in some:
            held_out[q][:, held] = _of_fold(
                basis, labels[rest, q], values, new @ metric, second[1][q].ridge
            )
    most = [
        max(UNLIKE * float(np.quantile(np.concatenate(each), 0.99)), 1e-6)
        for each in zip(*found, strict=True)
    ]
    judged = []
    for q, one in enumerate(second[1]):
        values, variances = held_out[q][:, one.rows]
        # A fold may hold out every row with a quantity: then keep the values from `_solve`.
        if np.isfinite(values).all() or (np.isfinite(values).any() and not whole):
            residuals = np.where(np.isfinite(values), labels[one.rows, q] - values, one.residuals)
            one = replace(one, residuals=residuals, variances=variances)
        judged.append(one)
    return (most[0], most[1]), judged


def _of_fold(basis: _Basis, labels: F64, values: F64, at: F64, ridge: float) -> tuple[F64, F64]:
    """Predictions for held-out frames, and their variances relative to the noise."""
    some = np.isfinite(labels)
    rows = basis.values[some]
    inverse = np.linalg.inv(rows.T @ rows + ridge * np.eye(rows.shape[1]))
    offset = labels[some].mean()
    weights = inverse @ (rows.T @ (labels[some] - offset))
    few = values[:, -FUNCTIONS:]  # as `predict` knows them
    variances = (few * few) @ _precision(basis, len(rows), ridge) + unreached(at, few) / ridge
    return offset + values @ weights, variances
