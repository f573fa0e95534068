"""Check that the imprint of a height map fits the numbers that a touch model predicts.

Pooled features of a ball's and a plate's imprint are alike, so a model of plates accepts a ball, and is wrong. Their
depth, area, volume and length differ: over the labelled table each is a quadratic function of the predicted numbers,
and a frame far from it shows another object.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tacshade_edge.types import F32, F64, TouchedObject, TouchModel


def imprint_of(objects: Sequence[TouchedObject], volume_mm3: float) -> F32:
    """Greatest depth, square root of area, cube root of volume, and length of the largest object: float32 (4,), mm."""
    depth_mm = max(one.depth_max_mm for one in objects)
    side_mm = math.sqrt(sum(one.area_mm2 for one in objects))
    edge_mm = math.cbrt(volume_mm3)
    length_mm = math.hypot(*objects[0].extent_mm[:2])
    return np.array((depth_mm, side_mm, edge_mm, length_mm), np.float32)


def terms(values: F64, low: F32, high: F32) -> F64:
    """1, the quantities (n, Q) relative to the labelled range, and all their pairwise products: (n, T)."""
    half = np.where(high > low, (high - low) / 2, 1)
    parts = (values - (low + high) / 2) / half
    first, second = np.triu_indices(parts.shape[1])
    made: F64 = np.concatenate((np.ones((len(parts), 1)), parts, parts[:, first] * parts[:, second]), axis=1)
    return made


def belongs(model: TouchModel, values: F64, imprint: F32) -> bool:
    """Whether a frame's imprint is like those of the table at the predicted values, float64 (Q,)."""
    left = imprint - terms(values[None], model.low, model.high)[0] @ model.imprint_weights
    return bool(left @ model.imprint_precision @ left <= model.imprint_max)
