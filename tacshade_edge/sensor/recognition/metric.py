"""Learn from many objects how touches of one object differ, and how objects do: the metric of
recognition.

A description is linear in two unknowns, the object's own and the touch's, each normally distributed
(probabilistic linear discriminant analysis: Ioffe 2006, Prince and Elder 2007). In the metric's
coordinates, touches of one object scatter about it with unit covariance, and objects scatter about
0 with a variance along each axis.
"""

from __future__ import annotations

import numpy as np

from tacshade_edge.types import F32, I64, frozen

CLIP = 5.0  # limit of a standardised number; more carries no information
SHRINKAGE = 0.15  # of the scatter within objects towards a multiple of the identity
# Variance between objects along an axis, relative to that of touches of one. Less is left out: such
# an axis says little, and costs as much as any.
LEAST_BETWEEN = 0.05


@frozen
class Metric:
    """Coordinates in which touches of one object scatter alike.

    Float32 arrays: `middle` and `spread` (D,) standardise a description, `axes` (D, d) and `origin`
    (d,) turn it into coordinates, `between` (d,) is the variance of objects along each axis; that
    of touches of one object is 1. `scores` (n, levels), ascending, are scores (`answer.scores`) of
    touches with their own object after 1 to n touches taught it; `trust` multiplies a score to give
    the logarithm of how much likelier the object is than another one.
    """

    middle: F32
    spread: F32
    axes: F32
    origin: F32
    between: F32
    scores: F32
    trust: float


def coordinates(metric: Metric, descriptions: F32) -> F32:
    """The coordinates (n, d) of descriptions (n, D)."""
    standard = (descriptions - metric.middle) / metric.spread
    return np.asarray(np.clip(standard, -CLIP, CLIP) @ metric.axes - metric.origin)


def learn_metric(descriptions: F32, objects: I64) -> Metric:
    """Learn a metric from descriptions (N, D) and their objects' numbers (N,), without scores and
    trust.
    """
    middle = np.median(descriptions, axis=0)
    spread = np.maximum(descriptions.std(axis=0), 1e-6)
    standard = np.clip((descriptions - middle) / spread, -CLIP, CLIP).astype(np.float64)
    _, which, counts = np.unique(objects, return_inverse=True, return_counts=True)
    means = np.zeros((len(counts), standard.shape[1]))
    np.add.at(means, which, standard)
    means /= counts[:, None]
    off = standard - means[which]
    within = off.T @ off / (len(off) - len(counts))
    # The means scatter as objects do, and by what n touches leave of their own scatter: 1 / n.
    between = np.cov(means.T) - within * float(np.mean(1 / counts))
    # Few objects show few directions: without shrinkage, one in which their touches happen to agree
    # would decide alone.
    own = within + SHRINKAGE * np.trace(within) / len(within) * np.eye(len(within))
    unit = np.linalg.inv(np.linalg.cholesky(own))
    variance, turn = np.linalg.eigh(unit @ between @ unit.T)
    # `eigh` sorts upwards; the axis that tells most comes first.
    axes, variance = (unit.T @ turn)[:, ::-1], variance[::-1]
    kept = int(np.count_nonzero(variance > LEAST_BETWEEN))
    axes = axes[:, :kept]
    return Metric(
        middle=np.asarray(middle, np.float32),
        spread=np.asarray(spread, np.float32),
        axes=np.ascontiguousarray(axes, np.float32),
        origin=np.asarray(standard.mean(axis=0) @ axes, np.float32),
        between=np.asarray(variance[:kept], np.float32),
        scores=np.zeros((1, 0), np.float32),
        trust=1.0,
    )
