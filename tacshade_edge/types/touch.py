"""A touch as a few numbers, and the model that predicts them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tacshade_edge.reasons import Reason
from tacshade_edge.types.arrays import F32, freeze

QUANTITIES = (
    "depth_mm",
    "tilt_x_deg",
    "tilt_y_deg",
    "shear_x_mm",
    "shear_y_mm",
    "twist_deg",
    "x_mm",
    "y_mm",
    "edge_deg",
    "force_x_n",
    "force_y_n",
    "force_z_n",
    "torque_x_nmm",
    "torque_y_nmm",
    "torque_z_nmm",
)
"""Columns of LABELS.csv; the first six are also known without labels."""


@dataclass(frozen=True, slots=True)
class Touch:
    """The touch that a frame shows, as numbers.

    Attributes
    ----------
    values, sigma : mapping of str to float or None
        Value and standard deviation of each quantity, in the unit of its name; None if the model does not know it.
    reason : Reason or None
        Why the model does not know some or all of them.
    """

    values: Mapping[str, float | None] = field(default_factory=dict)
    sigma: Mapping[str, float | None] = field(default_factory=dict)
    reason: Reason | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TouchModel:
    """A profile's touch model. D features, m components, M centres, K basis functions, Q quantities.

    Attributes
    ----------
    names : tuple of str
        Quantities that the model predicts, from `types.touch.QUANTITIES`.
    networks : str
        Digest of the networks that compute the features (`inference.network.touch_networks`).
    mean, deviation : float32 (D,)
        Mean and standard deviation of each feature over the table; the deviation is above 0.
    components : float32 (D, m)
        Map from standardised features to coordinates whose mean squares over the table add to 1.
    scale : float
        Length of a standardised feature vector whose coordinates have length 1.
    spread : float32 (m,)
        Standard deviation of each coordinate over the table, descending.
    centres : float32 (M, m)
    width : float
        Width of the squared-exponential kernel.
    basis : float32 (m + M, K)
        Map from kernel values to the basis functions that vary most over the table and are uncorrelated there.
    weights : float32 (m + M, Q)
        Weights of the kernel values in each quantity's mean.
    precision : float32 (K, Q)
        Posterior variance of each basis function's weight, in units of `noise`².
    ridge, offset, noise : float32 (Q,)
        Regularisation, mean over the table, and standard deviation of a label about the model.
    low, high : float32 (Q,)
        Range of the table's labels.
    leverage_max, residual_max : float
        Limits beyond which a frame is unlike those of the table: for the `leverage` of its coordinates, and for the
        share of its standardised features that the components leave out.
    imprint_weights : float32 (T, I)
        Map from the terms of the predicted quantities to their imprint in the table (`core.touch.answer`).
    imprint_precision : float32 (I, I)
        Inverse covariance of the imprint errors of held-out frames, divided by I.
    imprint_max : float
        Greatest squared distance of an imprint; a frame beyond it shows an object unlike the table's.

    Raises
    ------
    ValueError
        Shapes do not match, a number is not finite, or a deviation, width or limit is not above 0.
    """

    names: tuple[str, ...]
    networks: str
    mean: F32
    deviation: F32
    components: F32
    scale: float
    spread: F32
    centres: F32
    width: float
    basis: F32
    weights: F32
    precision: F32
    ridge: F32
    offset: F32
    noise: F32
    low: F32
    high: F32
    leverage_max: float
    residual_max: float
    imprint_weights: F32
    imprint_precision: F32
    imprint_max: float

    def __post_init__(self) -> None:
        freeze(self, *TOUCH_ARRAYS)
        shapes = _shapes(self)
        for name in TOUCH_ARRAYS:
            array: F32 = getattr(self, name)
            if array.dtype != np.float32 or array.shape != shapes[name]:
                raise ValueError(f"touch model: {name} is {array.dtype} {array.shape}, expected {shapes[name]}")
            if not np.isfinite(array).all():
                raise ValueError(f"touch model: {name} has a value that is not finite")
        positive = [self.deviation.min(), self.spread.min(), self.noise.min(), self.ridge.min(), self.width]
        positive += [self.scale, self.leverage_max, self.residual_max, self.imprint_max]
        if not all(np.isfinite(value) and value > 0 for value in positive) or (self.precision < 0).any():
            raise ValueError("touch model: a deviation, width or limit is not above 0")


TOUCH_ARRAYS = (
    "mean",
    "deviation",
    "components",
    "spread",
    "centres",
    "basis",
    "weights",
    "precision",
    "ridge",
    "offset",
    "noise",
    "low",
    "high",
    "imprint_weights",
    "imprint_precision",
)


def _shapes(model: TouchModel) -> dict[str, tuple[int, ...]]:
    """The expected shape of each array, from those of `components`, `centres`, `basis` and `imprint_weights`."""
    if (
        any(getattr(model, name).ndim != 2 for name in ("components", "centres", "basis", "imprint_weights"))
        or not model.names
    ):
        raise ValueError("touch model: found no quantity, or arrays that are no matrices")
    features, parts = model.components.shape
    centres, columns, quantities = len(model.centres), model.basis.shape[1], len(model.names)
    if min(features, parts, centres, columns) < 1:
        raise ValueError("touch model: found an empty matrix")
    each = (quantities,)
    terms, imprint = (quantities + 1) * (quantities + 2) // 2, model.imprint_weights.shape[1]
    return {
        "mean": (features,),
        "deviation": (features,),
        "components": (features, parts),
        "spread": (parts,),
        "centres": (centres, parts),
        "basis": (parts + centres, columns),
        "weights": (parts + centres, quantities),
        "precision": (columns, quantities),
        "imprint_weights": (terms, imprint),
        "imprint_precision": (imprint, imprint),
        **dict.fromkeys(("ridge", "offset", "noise", "low", "high"), each),
    }
