"""Compute a frame's touch by the calibration's model, or without one from height map and shear.

Principal components of the networks' pooled activations, turned and scaled by the directions in
which the quantities change, enter a Gaussian process with a linear and a squared-exponential
kernel, reduced to few centres, so that a frame costs three small matrix products (subset of
regressors: Rasmussen and Williams, Gaussian Processes for Machine Learning, MIT Press, 2006,
section 8.3).

Features of a ball's and a plate's imprint are alike, but their depth, area, volume and length
differ: over the labelled table each is a quadratic function of the predicted numbers, and a frame
far from it shows another object.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import F32, F64, Touch, TouchedObject, TouchModel

# Limit of a standardised feature; more carries no information.
CLIP = 6.0
# Square root of the linear kernel's weight relative to the squared-exponential one.
LINEAR = 0.5
# Factor on the ratios of components to the press, relative to the components.
RATIOS = 0.4
# Components whose distance from the untouched skin's is the press, and what is added to it in
# quadrature: the components' noise is no ratio.
PRESS_COMPONENTS, LEAST_PRESS = 4, 0.25
# Components used for the leverage; more are noise of few frames.
LEVERAGE_COMPONENTS = 64
# A value this many standard deviations beyond the labelled range is an extrapolation: the end of
# the 90 % interval.
MARGIN = 1.645
Floats = TypeVar("Floats", F32, F64)

PLAIN = ("depth_mm", "tilt_x_deg", "tilt_y_deg", "shear_x_mm", "shear_y_mm", "twist_deg")
"""Names of the quantities that need no labels."""

PLAIN_SIGMA = (0.4, 5.0, 5.0, 1.0, 1.0, 4.0)
"""Standard deviation of each without labels.

Plates on a sensor of the third family have less: 0.28, 1.1, 1.1, 0.34, 0.42, 2.9;
other objects and real skins are worse.
"""
NO_IMPRINT = np.full(4, np.nan, np.float32)  # of a frame without contact, in a table


def quantities_of(touch: object, *, has_shear: bool) -> tuple[str, ...] | Reason:
    """Names of the quantities that a touch can have by its model, or why it has none; without a
    model, those that need no labels.
    """
    if isinstance(touch, Reason):
        return touch
    if isinstance(touch, TouchModel):
        return touch.names
    # An object's twist is read off its shear.
    return PLAIN if has_shear else PLAIN[:3]


def imprint_of(objects: Sequence[TouchedObject], volume_mm3: float) -> F32:
    """Greatest depth, square root of area, cube root of volume, and length of the largest object:
    float32 (4,), mm.
    """
    depth_mm = max(one.depth_max_mm for one in objects)
    side_mm = math.sqrt(sum(one.area_mm2 for one in objects))
    edge_mm = math.cbrt(volume_mm3)
    length_mm = math.hypot(*objects[0].extent_mm[:2])
    return np.array((depth_mm, side_mm, edge_mm, length_mm), np.float32)


def terms(values: F64, low: F32, high: F32) -> F64:
    """1, the quantities (n, Q) relative to the labelled range, and all their pairwise products:
    (n, T).
    """
    # Relative to the range, so that one ridge suits millimetres, degrees and newtons.
    half = np.where(high > low, (high - low) / 2, 1)
    parts = (values - (low + high) / 2) / half
    once = np.tri(parts.shape[1], dtype=bool).T  # row by row
    made: F64 = np.concatenate(
        (np.ones((len(parts), 1)), parts, (parts[:, :, None] * parts[:, None])[:, once]), axis=1
    )
    return made


def belongs(model: TouchModel, values: F64, imprint: F32) -> bool:
    """Whether a frame's imprint is like those of the table at the predicted values,
    float64 (Q,).
    """
    left = imprint - terms(values[None], model.low, model.high)[0] @ model.imprint_weights
    return bool(left @ model.imprint_precision @ left <= model.imprint_max)


def predict(model: TouchModel, features: F32) -> tuple[F64, F64, bool]:
    """Predict the quantities (Q,) of a frame and their deviations,
    and whether the frame is like those of the table.
    """
    standard = scaled(features, model.mean, model.deviation)
    parts = standard @ model.components
    # Older models have no ratios in their metric: only its rows count.
    at = coordinates(parts[None], model.origin)[:, : len(model.metric)] @ model.metric
    near = kernel(at, model.centres, model.width)[0]
    mean = model.offset + near @ model.weights
    values = near @ model.basis
    spread = 1 + (values * values) @ model.precision + unreached(at, values[None]) / model.ridge
    # Two ways to be unlike: far away among the components, or outside of all of them.
    alike = leverage(parts[None], model.spread)[0] <= model.leverage_max
    alike = alike and residual(standard[None], parts[None], model.scale)[0] <= model.residual_max
    return mean.astype(np.float64), (model.noise * np.sqrt(spread)).astype(np.float64), bool(alike)


def scaled(features: F32, mean: F32, deviation: F32) -> F32:
    """Features less their mean, in standard deviations, clipped."""
    made = (features - mean) / deviation
    return np.clip(made, -CLIP, CLIP, out=made)


def coordinates(parts: Floats, origin: F32) -> Floats:
    """The components (n, m), and their ratios to the press, in which light ones show their tilt,
    too: (n, 2 m).
    """
    away = parts - origin
    press = np.sqrt((away[:, :PRESS_COMPONENTS] ** 2).sum(axis=1, keepdims=True) + LEAST_PRESS**2)
    return np.concatenate((parts, RATIOS * away / press), axis=1)


def kernel(at: Floats, centres: Floats, width: float) -> Floats:
    """The weighted coordinates (n, m) and their squared-exponential kernel with each centre, (n,
    m + M).
    """
    # A product sums faster than `sum`.
    ones = np.ones(at.shape[1], at.dtype)
    # |a - b|² = a² + b² - 2ab as one product of matrices; rounding may leave it below 0.
    squares = ((at * at) @ ones)[:, None] + (centres * centres) @ ones - 2 * (at @ centres.T)
    near = np.exp(np.maximum(squares, 0) * (-0.5 / width**2))
    return np.concatenate((at * at.dtype.type(LINEAR), near), axis=1)


def leverage(at: Floats, spread: F32) -> Floats:
    """Mean square of each frame's first coordinates in standard deviations, (n,)."""
    first = at[:, :LEVERAGE_COMPONENTS] / spread[:LEVERAGE_COMPONENTS]
    found: Floats = (first * first).mean(axis=1)
    return found


def residual(standard: Floats, at: Floats, scale: float) -> Floats:
    """The part of each frame's squared standardised features that its coordinates leave out, (n,),
    0 to 1.
    """
    # Pythagoras: the components are orthonormal but for the scale. Rounding may leave less than 0.
    left = 1 - scale**2 * (at * at).sum(axis=1) / np.maximum(
        (standard * standard).sum(axis=1), 1e-12
    )
    found: Floats = np.maximum(left, 0)
    return found


def unreached(at: Floats, values: Floats) -> Floats:
    """The kernel's variance that the basis functions leave out, (n,):
    no label lowers it (section 8.3).
    """
    own = 1 + LINEAR**2 * (at * at).sum(axis=1)
    left: Floats = np.maximum(own - (values * values).sum(axis=1), 0)
    return left


def touch_by_model(model: TouchModel, features: F32, imprint: F32 | None) -> Touch:
    """The touch that a model predicts from a frame's features, float32 (D,), and its imprint
    (`imprint_of`), which is None if the height map shows no contact. Values beyond the labelled
    range have an interval that reaches back to it; those farther off than the range is wide are
    unknown.
    """
    values, sigma, alike = predict(model, features)
    if not alike or (imprint is not None and not belongs(model, values, imprint)):
        unknown = dict.fromkeys(model.names)
        whose = (
            "imprint is unlike the labelled object's imprint"
            if alike
            else "frame is unlike any labelled frame"
        )
        return Touch(unknown, unknown, Reason(ReasonCode.TOUCH_UNLIKE, f"the {whose}"))
    beyond = np.maximum(np.maximum(model.low - values, values - model.high), 0)
    outside, far = beyond > MARGIN * sigma, beyond > model.high - model.low
    names = [name for name, out in zip(model.names, outside, strict=True) if out]
    reason = (
        Reason(ReasonCode.TOUCH_RANGE, f"outside the labelled range: {', '.join(names)}")
        if names
        else None
    )
    known, error = (
        {
            name: None if gone else one
            for name, gone, one in zip(model.names, far, each.tolist(), strict=True)
        }
        for each in (values, np.where(outside, np.hypot(sigma, beyond), sigma))
    )
    return Touch(known, error, reason)


def touch_without_labels(
    objects: Sequence[TouchedObject], shear_mm: tuple[float, float] | None
) -> Touch:
    """The touch without a model: greatest depth, tilt of the largest object's plane and its twist,
    and mean shear.
    """
    first = objects[0]
    x, y, z = first.normal
    # The normal of a skin turned about x, then about y; rounding may take a part of a unit vector
    # beyond 1.
    tilt_x_deg, tilt_y_deg = (
        -math.degrees(math.asin(max(-1.0, min(1.0, y)))),
        math.degrees(math.atan2(x, z)),
    )
    shear = (None, None) if shear_mm is None else shear_mm
    depth_mm = max(one.depth_max_mm for one in objects)
    values = dict(
        zip(PLAIN, (depth_mm, tilt_x_deg, tilt_y_deg, *shear, first.twist_deg), strict=True)
    )
    sigma = dict(zip(PLAIN, PLAIN_SIGMA, strict=True))
    return Touch(
        values, {name: None if values[name] is None else one for name, one in sigma.items()}
    )
