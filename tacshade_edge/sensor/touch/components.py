"""A table of labelled frames, and the principal components of its features."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tacshade_edge.sensor.touch.touch_answer import scaled
from tacshade_edge.types import F32, F64, I64

COMPONENTS = 96
UNTOUCHED = 0.03
"""Share of the frames, the least changed, whose mean stands for the untouched skin."""
_STEADY, _LEAST_DEVIATION = np.float32(1e-3), np.float32(1e-6)


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Labelled frames: features (n, D), the changed parts of their pictures (n,), 0 to 1, labels
    (n, Q), NaN where a frame has none, and groups (n,). Frames of one press share a group.
    """

    features: F32
    changed_parts: F64
    labels: F64
    groups: I64


@dataclass(frozen=True, slots=True, eq=False)
class Components:
    """Principal components of a table: features less `mean` (D,) in units of `deviation` (D,),
    times `components` (D, m), are coordinates whose mean squares over the table add to 1.

    `at`: the frames' coordinates (n, m), `spread` (m,) their deviations, `origin` (m,) those of the
    untouched skin. `scale`: length of a standardised feature vector with coordinates of length 1.
    """

    mean: F32
    deviation: F32
    components: F32
    scale: float
    at: F64
    spread: F32
    origin: F32


def components_of(features: F32, changed_parts: F64) -> Components:
    """The components of features (n, D); changed parts of the picture (n,) show the untouched."""
    mean, deviation = features.mean(axis=0), features.std(axis=0)
    # A feature that hardly varies over the table is noise: on its own scale it would weigh as much
    # as any other, and clip at the first frame that moves it.
    deviation = deviation + _STEADY * np.float32(features.std()) + _LEAST_DEVIATION
    standard = scaled(features, mean, deviation)
    rows, columns = standard.shape
    count = min(COMPONENTS, rows - 2, columns)
    # Of the two Gram matrices, the smaller has the same eigenvalues.
    if rows <= columns:
        _, vectors = np.linalg.eigh((standard @ standard.T).astype(np.float64))
        components = standard.T @ vectors[:, : -count - 1 : -1].astype(np.float32)
        components /= np.maximum(np.linalg.norm(components, axis=0), np.float32(1e-12))
    else:
        _, vectors = np.linalg.eigh((standard.T @ standard).astype(np.float64))
        components = vectors[:, : -count - 1 : -1].astype(np.float32)
    at = standard @ components
    scale = float(np.sqrt((at.astype(np.float64) ** 2).sum(axis=1).mean())) or 1.0
    # Rounded first, because the file stores 16 bits.
    components = (components / np.float32(scale)).astype(np.float16).astype(np.float32)
    at = standard @ components
    origin = at[np.argsort(changed_parts)[: math.ceil(UNTOUCHED * rows)]].mean(axis=0)
    spread = np.maximum(at.std(axis=0, dtype=np.float64), 1e-9).astype(np.float32)
    return Components(mean, deviation, components, scale, at.astype(np.float64), spread, origin)
