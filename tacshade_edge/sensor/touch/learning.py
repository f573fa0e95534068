"""Learn the touch model in closed form from a table of labelled frames:
no gradient descent, no random numbers.

Kernel width and regularisation minimise the error on held-out groups of frames (`regression`).

Most components show nothing of the quantities. A first fit finds the directions along which its
answers change, by the mean outer product of their gradients; the second fit sees these, each scaled
by the square root of that change (one step of Radhakrishnan, Beaglehole, Pandit and Belkin, Science
383, 2024).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.sensor.touch.components import COMPONENTS, Components, Table, components_of
from tacshade_edge.sensor.touch.folds import LEAST_ROWS, UNLIKE, Limits, judged
from tacshade_edge.sensor.touch.regression import (
    CENTRES,
    DIRECTIONS,
    FUNCTIONS,
    BasisFit,
    Solved,
    fitted,
    held_out,
    metric_of,
    precision_of,
)
from tacshade_edge.sensor.touch.touch_answer import coordinates, terms
from tacshade_edge.types import F32, F64, I64, TouchModel

__all__ = [
    "CENTRES",
    "COMPONENTS",
    "DIRECTIONS",
    "FUNCTIONS",
    "LEAST_GROUPS",
    "LEAST_ROWS",
    "LearntTouch",
    "QuantityReport",
    "learn",
]

LEAST_GROUPS = 5
"""Least number of groups with a quantity: the prediction of a held-out press needs others."""
GATE_QUANTILE, GATE_SHARE = 0.01, 0.8
"""The model answers a frame that has changed by at least this share
of this quantile over the table.
"""
SEEN_ERRORS, SEEN = 2.0, 0.1
"""Least held-out R² of a quantity that the frames show, in deviations of chance, 1 / √n, and at
least: without it, labels at random would now and then be learnt.
"""
ANOTHER = 5.0
"""An imprint is another object's beyond this multiple of held-out squared distances' 95th
percentile, and beyond `UNLIKE` times their 99.5th.
"""
IMPRINT_RIDGE = 3.0
LEAST_DEVIATION = 1e-3
"""Of an imprint's number over the table, in mm, and of held-out variance relative to the table's.
"""
CONTRADICTS = 5.0
"""A row contradicts the others if its held-out residual exceeds this many robust standard
deviations.
"""
_LEAST_VARIANCE = 1e-12
_MAD = 1.4826  # a Gaussian's standard deviation over its median absolute deviation


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
class _Seen:
    """The quantities that the frames show: their fit, labels (n, Q) and the labels' range (Q,)."""

    names: tuple[str, ...]
    fit: BasisFit
    labels: F64
    low: F32
    high: F32


@dataclass(frozen=True, slots=True, eq=False)
class _ImprintFit:
    """`TouchModel.imprint_weights` (T, I), `imprint_precision` (I, I) and `imprint_max`."""

    weights: F64
    precision: F64
    most: float


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
    space = components_of(features, changed_parts)
    whole = coordinates(space.at, space.origin)
    first = fitted(whole, labels, groups)
    metric = metric_of(first, whole, labels)
    second = fitted(whole @ metric, labels, groups)
    limits, solved = judged(Table(features, changed_parts, labels, groups), space, first, second)
    reports = tuple(_report(name, labels[:, q], solved[q]) for q, name in enumerate(names))
    kept = [q for q, report in enumerate(reports) if report.seen]
    if not kept:
        return LearntTouch(None, reports)
    low, high = (
        ends(labels[:, kept], axis=0).astype(np.float32) for ends in (np.nanmin, np.nanmax)
    )
    fit = BasisFit(second.basis, [solved[q] for q in kept])
    seen = _Seen(tuple(names[q] for q in kept), fit, labels[:, kept], low, high)
    touching = np.isfinite(imprints[:, 0])
    imprint = _imprint_fit(
        imprints[touching].astype(np.float64),
        terms(_answers(seen)[touching], low, high),
        groups[touching],
    )
    gate_part = GATE_SHARE * float(np.quantile(changed_parts, GATE_QUANTILE))
    return LearntTouch(_model(space, metric, seen, imprint, limits, gate_part, networks), reports)


def _answers(seen: _Seen) -> F64:
    """The quantities (n, Q): predictions from the other groups for each labelled row, and from the
    model for the rest.
    """
    solved = seen.fit.solved
    values = np.stack([one.offset + seen.fit.basis.values @ one.weights for one in solved], axis=1)
    for k, one in enumerate(solved):
        values[one.rows, k] = seen.labels[one.rows, k] - one.residuals
    return values


def _model(
    space: Components,
    metric: F64,
    seen: _Seen,
    imprint: _ImprintFit,
    limits: Limits,
    gate_part: float,
    networks: str,
) -> TouchModel:
    """Everything in the numbers of the file."""
    basis, solved = seen.fit.basis, seen.fit.solved
    weights = np.stack([basis.matrix @ one.weights for one in solved], axis=1)
    precision = np.stack([precision_of(basis, len(one.rows), one.ridge) for one in solved], axis=1)
    return TouchModel(
        names=seen.names,
        networks=networks,
        mean=space.mean,
        deviation=space.deviation,
        components=space.components,
        scale=space.scale,
        spread=space.spread,
        origin=space.origin,
        metric=metric.astype(np.float32),
        gate_part=gate_part,
        centres=basis.centres.astype(np.float32),
        width=basis.width,
        basis=basis.matrix[:, -FUNCTIONS:].astype(np.float32),
        weights=weights.astype(np.float32),
        precision=precision.astype(np.float32),
        ridge=np.array([one.ridge for one in solved], np.float32),
        offset=np.array([one.offset for one in solved], np.float32),
        noise=np.array([one.noise for one in solved], np.float32),
        low=seen.low,
        high=seen.high,
        leverage_max=limits.leverage,
        residual_max=limits.residual,
        imprint_weights=imprint.weights.astype(np.float32),
        imprint_precision=imprint.precision.astype(np.float32),
        imprint_max=imprint.most,
    )


def _imprint_fit(imprints: F64, values: F64, groups: I64) -> _ImprintFit:
    """Fit the imprint by least squares from the quantities' terms, (n, T), with the errors of
    held-out groups.
    """
    if not len(imprints):  # any imprint belongs
        count = imprints.shape[1]
        return _ImprintFit(np.zeros((values.shape[1], count)), np.zeros((count, count)), 1.0)
    mean, deviation = imprints.mean(axis=0), np.maximum(imprints.std(axis=0), LEAST_DEVIATION)
    standard = (imprints - mean) / deviation
    power, turned = np.linalg.eigh(values.T @ values)
    values, inverse = values @ turned, 1 / (np.maximum(power, 0)[:, None] + IMPRINT_RIDGE)
    at = values.T @ standard
    held = [
        held_out(values, values**2, inverse, *each, groups)[0]
        for each in zip(standard.T, at.T, strict=True)
    ]
    off = np.concatenate(held, axis=1)
    weights = turned @ (inverse * at) * deviation
    # The first term is the constant 1.
    weights[0] += mean
    # Divided by the numbers of an imprint, so that a distance of 1 is usual for any.
    covariance = off.T @ off / len(off) + LEAST_DEVIATION * np.eye(off.shape[1])
    precision = np.linalg.inv(covariance) / off.shape[1]
    distances = ((off @ precision) * off).sum(axis=1)
    at_95, at_995 = np.quantile(distances, (0.95, 0.995)).tolist()
    most = max(ANOTHER * at_95, UNLIKE * at_995, 1e-6)
    return _ImprintFit(weights, precision / np.outer(deviation, deviation), most)


def _report(name: str, labels: F64, solved: Solved) -> QuantityReport:
    residuals, known = np.abs(solved.residuals), labels[solved.rows]
    held = residuals[np.isfinite(solved.variances)]
    # In the labels' own size: squares of small ones are 0. One that is always the same teaches
    # nothing, however well it is foretold.
    most = float(np.abs(known).max()) or 1.0
    variance = float(np.var(known / most))
    varies = variance > _LEAST_VARIANCE
    r2 = 1 - float(np.mean((held / most) ** 2)) / variance if varies else 0.0
    seen = varies and r2 >= max(SEEN, SEEN_ERRORS / float(np.sqrt(len(known))))
    contradicts = residuals > CONTRADICTS * _MAD * float(np.median(residuals))
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
