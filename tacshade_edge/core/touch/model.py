"""Predict a few numbers, each with a standard deviation, from the features of a frame.

The features are pooled activations of the networks (`inference.network.touch_networks`). Their principal components
enter a Gaussian process with a linear and a squared-exponential kernel, reduced to few enough centres that a frame
costs two small matrix products (subset of regressors: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for
Machine Learning, MIT Press, 2006, section 8.3). `learning` fits it in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tacshade_edge.types import F32, F64, TouchModel

CLIP = 6.0
"""Limit of a standardised feature; more carries no information."""
LINEAR = 0.5
"""Square root of the linear kernel's weight relative to the squared-exponential one."""
LEVERAGE_COMPONENTS = 64
"""Components used for the leverage; more are noise of few frames."""

Floats = TypeVar("Floats", F32, F64)


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """A model's answer (Q,) to one frame's features, and whether the frame is like those of the table."""

    values: F64
    sigma: F64
    alike: bool


def predict(model: TouchModel, features: F32) -> Prediction:
    """Predict the quantities of a frame from its features, float32 (D,)."""
    standard = standardised(features, model.mean, model.deviation)
    at = standard @ model.components
    near = kernel_values(at[None], model.centres, model.width)[0]
    mean = model.offset + near @ model.weights
    values = near @ model.basis
    spread = 1 + (values * values) @ model.precision + unreached(at[None], values[None]) / model.ridge
    alike = leverage(at[None], model.spread)[0] <= model.leverage_max
    alike = alike and residual(standard[None], at[None], model.scale)[0] <= model.residual_max
    return Prediction(mean.astype(np.float64), (model.noise * np.sqrt(spread)).astype(np.float64), bool(alike))


def standardised(features: F32, mean: F32, deviation: F32) -> F32:
    """Features less their mean, in standard deviations, clipped."""
    made = (features - mean) / deviation
    return np.clip(made, -CLIP, CLIP, out=made)


def kernel_values(at: Floats, centres: Floats, width: float) -> Floats:
    """The weighted coordinates (n, m) and their squared-exponential kernel with each centre, (n, m + M)."""
    squares = (at * at).sum(axis=1)[:, None] + (centres * centres).sum(axis=1) - 2 * (at @ centres.T)
    near = np.exp(np.maximum(squares, 0) * (-0.5 / width**2))
    return np.concatenate((at * at.dtype.type(LINEAR), near), axis=1)


def leverage(at: Floats, spread: Floats) -> Floats:
    """Mean square of each frame's first coordinates in standard deviations, (n,)."""
    first = at[:, :LEVERAGE_COMPONENTS] / spread[:LEVERAGE_COMPONENTS]
    found: Floats = (first * first).mean(axis=1)
    return found


def residual(standard: Floats, at: Floats, scale: float) -> Floats:
    """The part of each frame's squared standardised features that its coordinates leave out, (n,), 0 to 1."""
    left = 1 - scale**2 * (at * at).sum(axis=1) / np.maximum((standard * standard).sum(axis=1), 1e-12)
    found: Floats = np.maximum(left, 0)
    return found


def unreached(at: Floats, values: Floats) -> Floats:
    """The kernel's variance that the basis functions leave out, (n,): no label lowers it ([1] 8.3)."""
    own = 1 + LINEAR**2 * (at * at).sum(axis=1)
    left: Floats = np.maximum(own - (values * values).sum(axis=1), 0)
    return left
