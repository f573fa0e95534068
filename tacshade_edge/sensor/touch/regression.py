"""Gaussian-process regression on a few centres, in closed form, with the errors of held-out groups.

Subset of regressors: Rasmussen and Williams, Gaussian Processes for Machine Learning, MIT Press,
2006, section 8.3. A linear model gives the errors of a held-out group without another fit (eq.
5.12, here for several rows): r_g = (I - H_gg)⁻¹ (y_g - ŷ_g).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tacshade_edge.sensor.touch.touch_answer import LINEAR, kernel, unreached
from tacshade_edge.types import F64, I64

DIRECTIONS = 32
"""Of the coordinates, in which the quantities change."""
LEAST_CHANGE = 1e-4
"""Added to a direction's mean squared gradient, relative to the greatest."""
CENTRES = 1000
FUNCTIONS = 128
"""Basis functions with a variance of their own: a model takes at most 1.6 MB in a file."""
WIDTHS = (0.7, 1.0, 1.4, 2.0, 3.0)
"""Kernel widths to try, relative to the root mean square of a frame's coordinates."""
RIDGES = np.logspace(-3, 3, 25)
HELD_NUMBERS = 1_000_000
"""Numbers of a group's matrices at a time, 8 MB each, unless those of one ridge are more."""
Z_90 = 1.645
"""Half width of the 90 % interval of a Gaussian error, in its deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """Functions (n, K), uncorrelated over the table (`values`), sums of their squares (`power`),
    and the variance beyond the centres (`unreached`); `matrix` makes them of kernel values.
    """

    width: float
    centres: F64
    matrix: F64
    values: F64
    power: F64
    unreached: F64


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
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


@dataclass(frozen=True, slots=True, eq=False)
class BasisFit:
    """A basis, and every quantity solved in it."""

    basis: Basis
    solved: list[Solved]


def fitted(at: F64, labels: F64, groups: I64) -> BasisFit:
    """The fit of the kernel width with the least held-out error, from coordinates (n, m), labels
    (n, Q), NaN where unknown, and groups (n,).
    """

    def tried(width: float) -> tuple[float, BasisFit]:
        basis = basis_of(at, width)
        solved = [solve(basis, column, groups) for column in labels.T]
        # Logarithms, so that a quantity that no frame shows chooses nothing.
        return (
            float(np.mean([np.log(np.abs(one.residuals).mean() + 1e-300) for one in solved])),
            BasisFit(basis, solved),
        )

    return min(map(tried, WIDTHS), key=lambda one: one[0])[1]  # holds two fits at a time, not all


def metric_of(fit: BasisFit, at: F64, labels: F64) -> F64:
    """The directions (m, n) of coordinates in which a fit's answers change,
    so that coordinates keep their length.
    """
    basis = fit.basis
    size = at.shape[1]
    near = kernel(at, basis.centres, basis.width)[:, size:]
    changes = np.zeros((size, size))
    for q, one in enumerate(fit.solved):
        weights = basis.matrix @ one.weights
        pull = near * weights[size:]
        # The gradient of the answer: of the squared-exponential part, and of the linear one.
        slopes = (
            pull @ basis.centres - pull.sum(axis=1)[:, None] * at
        ) / basis.width**2 + LINEAR * weights[:size]
        changes += slopes.T @ slopes / variance_of(labels[one.rows, q])
    power, turned = np.linalg.eigh(changes)
    scale = (np.maximum(power, 0) / max(power[-1], 1e-300) + LEAST_CHANGE) ** 0.25
    metric: F64 = (turned * scale)[:, : -DIRECTIONS - 1 : -1]
    metric /= np.sqrt(((at @ metric) ** 2).sum(axis=1).mean()) or 1.0
    # Rounded before the second fit, as the file stores 32 bits: that fit is of what is stored.
    return metric.astype(np.float32).astype(np.float64)


def variance_of(labels: F64) -> float:
    """Variance of the labels, above 0 even if all are equal."""
    return max(float(np.var(labels)), 1e-12)


def basis_of(at: F64, width: float) -> Basis:
    """The basis functions of coordinates (n, m) for a kernel width."""
    # Evenly over the table, in its order: no random numbers, so that a table gives one model.
    centres = at[np.linspace(0, len(at) - 1, min(CENTRES, len(at))).astype(np.int64)]
    parts = at.shape[1]
    power, turned = np.linalg.eigh(kernel(centres, centres, width)[:, parts:])
    # What is less is rounding, and would have the greatest weight by the inverse root below.
    keep = power > 1e-6 * power[-1]
    # The centres' functions with the weights of a Gaussian process: K_zz^(-1/2).
    matrix = np.zeros((parts + len(centres), parts + int(keep.sum())))
    matrix[:parts, :parts] = np.eye(parts)
    matrix[parts:, parts:] = turned[:, keep] / np.sqrt(power[keep])
    values = kernel(at, centres, width) @ matrix
    # Turned so that the functions are uncorrelated over the table, upwards: the last vary most.
    powers, turned = np.linalg.eigh(values.T @ values)
    values = values @ turned
    return Basis(
        width, centres, matrix @ turned, values, np.maximum(powers, 0), unreached(at, values)
    )


def solve(basis: Basis, labels: F64, groups: I64, ridge: float | None = None) -> Solved:
    """Solve for labels (n,) by least squares, without a ridge with that of least held-out error."""
    rows = np.flatnonzero(np.isfinite(labels))
    # Over some of the rows the functions are correlated again.
    some = len(rows) < len(basis.values)
    values, power = basis.values[rows], basis.power
    if some:
        power, turned = np.linalg.eigh(values.T @ values)
        power, values = np.maximum(power, 0), values @ turned
    offset = float(labels[rows].mean())
    left, squares = labels[rows] - offset, values * values
    at = values.T @ left
    ridges = RIDGES if ridge is None else np.array([ridge])
    residuals, variances = held_out(
        values, squares, 1 / (power[:, None] + ridges), left, at, groups[rows]
    )
    best = int(np.argmin(np.abs(residuals).mean(axis=0)))
    ridge = float(ridges[best])
    weights = at / (power + ridge)
    variances = variances[:, best] + basis.unreached[rows] / ridge
    return Solved(
        rows, ridge, offset, turned @ weights if some else weights, residuals[:, best], variances
    )


def precision_of(basis: Basis, rows: int, ridge: float) -> F64:
    """Variance of the weight of each of the basis functions that vary most,
    relative to the noise.
    """
    return np.asarray(1 / (basis.power[-FUNCTIONS:] * (rows / len(basis.values)) + ridge))


def held_out(
    values: F64, squares: F64, inverse: F64, left: F64, at: F64, groups: I64
) -> tuple[F64, F64]:
    """Residuals and variances (n, R) of the rows, each predicted from the other groups,
    by R inverses (K, R).
    """
    residuals = left[:, None] - values @ (inverse * at[:, None])
    # 1 / n is the offset's part of H: it is the labels' mean, which each row has moved, too.
    own = squares @ inverse + 1 / len(values)
    order = np.argsort(groups, kind="stable")
    starts = np.flatnonzero(np.diff(groups[order], prepend=groups[order[0]] - 1))
    held, variances = (each / np.maximum(1 - own, 1e-6) for each in (residuals, own))
    for rows in np.split(order, starts[1:]):
        if len(rows) == 1:
            continue
        # As many ridges at a time as memory allows: a group may be a press of a thousand frames.
        some = max(1, HELD_NUMBERS // (len(rows) * max(len(rows), values.shape[1])))
        for first in range(0, inverse.shape[1], some):
            part = slice(first, first + some)
            hat = (values[rows] * inverse.T[part, None]) @ values[rows].T + 1 / len(values)
            # (I - H_gg)⁻¹. A little more than I: a group that decides its own fit leaves nothing to
            # invert.
            without = np.linalg.inv(np.eye(len(rows)) * (1 + 1e-6) - hat)
            held[rows, part] = np.einsum("rij,jr->ir", without, residuals[rows, part])
            variances[rows, part] = np.maximum(np.einsum("rij,rji->ir", hat, without), 0)
    return held, variances
