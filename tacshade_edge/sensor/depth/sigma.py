"""Predict the standard deviation of the height at every cell of a contact: a log-linear model of
the network's own outputs, fitted on simulated sensors (tools/training/fit_sigma.py), times the
error scale that the sensor's presses show. With k the skin's radius over 20 mm (`skin_scale`),

    log(σ / k) = log scale + Σ w_i x_i,    x = (1, log(0.1 + h / k), min(|∇h|, 2), l_c, l_f),

the slope ∇h by Sobel differences over the disc seen flat, l_c the log odds of contact between -2
and 8, l_f those of an untrusted cell between -12 and 0. Errors are not Gaussian: ±1.645 σ holds 90
% of them, by quantile regression.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.types import F32, Bool, Geometry

TERMS = ("constant", "height", "slope", "contact", "untrusted")  # names of the x_i
INTERVAL_90 = 1.645  # half width of the 90 % interval, in σ
_LEAST_HEIGHT_MM = 0.1
_STEEPEST = 2.0
_CONTACT_RANGE, _UNTRUSTED_RANGE = (-2.0, 8.0), (-12.0, 0.0)


@dataclass(frozen=True, slots=True)
class SigmaModel:
    """The errors of a network: weights of `TERMS`; the error scale of a sensor with only
    references; log scale = press_offset + press_slope · log q for one whose presses are off by q σ
    of scale 1 (`refit.error_scale`).
    """

    weights: tuple[float, ...]
    scale_without_presses: float
    press_offset: float
    press_slope: float

    def __post_init__(self) -> None:
        numbers = (*self.weights, self.scale_without_presses, self.press_offset, self.press_slope)
        if (
            not all(map(math.isfinite, numbers))
            or self.scale_without_presses <= 0
            or len(self.weights) != len(TERMS)
        ):
            raise ValueError(
                f"found {self}, expected finite numbers, a weight for each of {', '.join(TERMS)}"
            )


def terms(
    height_mm: F32, contact_logit: F32, untrusted_logit: F32, where: Bool, geometry: Geometry
) -> F32:
    """The x_i of the chosen cells `where`, bool (cells, cells): float32 (N, len(TERMS)), finite.

    `height_mm` and `contact_logit` are float32 (cells, cells) on `disc_map.map_grid`, heights NaN
    or 0 outside the disc; `untrusted_logit` is float32 (M, M).
    """
    cells = len(height_mm)
    left, top, width, height = cv2.boundingRect(where.view(np.uint8))
    # With each cell's neighbours, which its slope needs.
    box = slice(max(top - 1, 0), top + height + 1), slice(max(left - 1, 0), left + width + 1)
    near, at = np.fmax(height_mm[box], np.float32(0)), np.flatnonzero(where[box])
    along, across = (
        cv2.Sobel(near, cv2.CV_32F, *order, ksize=3, borderType=cv2.BORDER_REPLICATE).take(at)
        for order in ((1, 0), (0, 1))
    )
    disc_mm = geometry.visible_radius_mm
    cell_mm = 2 * disc_map.REACH * disc_mm / cells
    each = cells // len(untrusted_logit)
    untrusted = untrusted_logit.repeat(each, axis=0).repeat(each, axis=1)[box].take(at)
    x = np.empty((len(TERMS), len(at)), np.float32)
    x[0] = 1
    x[1] = np.log(_LEAST_HEIGHT_MM + near.take(at) / np.float32(disc_map.skin_scale(geometry)))
    # Sobel's weights add to 8 for a slope of 1 per cell.
    x[2] = np.minimum(np.hypot(along, across) / (8 * cell_mm), _STEEPEST)
    for k, logit, (low, high) in (
        (3, contact_logit[box].take(at), _CONTACT_RANGE),
        (4, untrusted, _UNTRUSTED_RANGE),
    ):
        # `fmin` replaces NaN by the upper end: more doubt of an untrusted cell, and contact.
        np.maximum(np.fmin(logit, np.float32(high)), np.float32(low), out=x[k])
    return x.T


def sigma_of_scale_1(model: SigmaModel, x: F32, geometry: Geometry) -> F32:
    """σ in mm at cells with these `terms`, for a sensor of scale 1: float32 (N,)."""
    # No matmul: BLAS sets floating-point flags in lanes of padding, and NumPy warns of them.
    sigma: F32 = np.exp((x * np.array(model.weights, np.float32)).sum(axis=1)) * np.float32(
        disc_map.skin_scale(geometry)
    )
    return sigma
