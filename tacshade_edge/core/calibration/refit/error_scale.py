"""Measure a sensor's error scale, the factor on σ (`core.depth.sigma`), from its presses.

q is the quantile of errors, in σ of scale 1, that the 90 % interval must hold, over presses left out of the fit, as in
split conformal prediction (Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World, 2005). Presses differ
from later contacts: errors on other shapes are larger, and a sensor with few presses is less unusual than it seems. So
a line fitted on simulated sensors converts log q to the logarithm of the scale.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tacshade_edge.core.depth.sigma import INTERVAL_90, SigmaModel, sigma_of_scale_1, terms
from tacshade_edge.types import F32, F64, Bool, Geometry

_SCALE_RANGE = (0.2, 20.0)


def errors_in_sigma(
    model: SigmaModel,
    height_mm: F32,
    true_mm: F32,
    contact_logit: F32,
    untrusted_logit: F32,
    known: Bool,
    geometry: Geometry,
) -> F64:
    """|error| over σ of scale 1 of a press, at the cells with known height: (N,)."""
    x = terms(height_mm, contact_logit, untrusted_logit, known, geometry)
    off = np.abs(height_mm[known].astype(np.float64) - true_mm[known])
    return np.asarray(off / sigma_of_scale_1(model, x, geometry))


def error_scale(model: SigmaModel, presses: Sequence[F64]) -> float:
    """The error scale from `errors_in_sigma` of at least one press, none of them empty; presses count alike."""
    scale = math.exp(model.press_offset + model.press_slope * math.log(press_q(presses)))
    return min(max(scale, _SCALE_RANGE[0]), _SCALE_RANGE[1])


def press_q(presses: Sequence[F64]) -> float:
    """The 90 % quantile of the presses' errors, in half widths of the 90 % interval of scale 1; above 0."""
    errors = np.concatenate(presses)
    weights = np.concatenate([np.full(len(each), 1 / len(each)) for each in presses])
    order = np.argsort(errors)
    below = np.cumsum(weights[order])
    found = float(errors[order][np.searchsorted(below, 0.9 * below[-1])])
    return max(found / INTERVAL_90, 1e-3)
