"""Does the imprint that a height map shows belong to the numbers that a touch model answers?

Pooled features of a ball's and a plate's imprint are alike, so a model of plates answers a ball, and wrongly. Depth,
area, volume and length of the two are not alike: over the labelled table each is a quadratic function of the answered
numbers, and a frame that is far from it shows another object.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tacshade_edge.types import F32, F64, TouchedObject, TouchModel


def imprint_of(objects: Sequence[TouchedObject], volume_mm3: float) -> F32:
    """Greatest depth, roots of area and volume, and length of the greatest object: float32 (4,), mm."""
    depth_mm = max(one.depth_max_mm for one in objects)
    side_mm = math.sqrt(sum(one.area_mm2 for one in objects))
    edge_mm = math.cbrt(volume_mm3)
    length_mm = math.hypot(*objects[0].extent_mm[:2])
    return np.array((depth_mm, side_mm, edge_mm, length_mm), np.float32)


def terms(values: F64, low: F32, high: F32) -> F64:
    """1, the quantities (n, Q) in parts of the labelled range, and all their products of two: (n, T)."""
    half = np.where(high > low, (high - low) / 2, 1)
    parts = (values - (low + high) / 2) / half
    first, second = np.triu_indices(parts.shape[1])
    made: F64 = np.concatenate((np.ones((len(parts), 1)), parts, parts[:, first] * parts[:, second]), axis=1)
    return made


def belongs(model: TouchModel, values: F64, imprint: F32) -> bool:
    """Whether a frame's imprint is like those of the table at the answered values, float64 (Q,)."""
    left = imprint - terms(values[None], model.low, model.high)[0] @ model.imprint_weights
    return bool(left @ model.imprint_precision @ left <= model.imprint_max)
