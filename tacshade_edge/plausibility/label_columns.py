"""Labelled quantities against what the map of the same frames shows without labels.

Correlation does not depend on the unit: where labels and map go together, the ratio of their
spreads is the unit, and the correlation's sign theirs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from tacshade_edge.plausibility.suspicions import Suspicion, SuspicionCode, suspicion
from tacshade_edge.plausibility.units import ANGLES, LENGTHS, nearest
from tacshade_edge.types import F64, Bool

ROWS_LEAST: Final = 12
# The map of a known kind of sensor goes with depths and tilts by 0.9 and more, and has their spread
# within a half.
_TOGETHER, _APART = 0.8, 0.5
_FACTOR: Final = 5.0
# A factor this near to a unit's cannot be another mistake.
_UNIT_WITHIN: Final = 2.0
_UNITS: Final = {"mm": LENGTHS, "deg": ANGLES}
_PAIRS: Final = (("tilt_x_deg", "tilt_y_deg"), ("shear_x_mm", "shear_y_mm"))

Columns = Mapping[str, F64]
"""Values of each frame (N,) by quantity; NaN where unknown."""


def judge_labels(labels: Columns, seen: Columns) -> tuple[Suspicion, ...]:
    """What is wrong with the labels, judging by what is seen of the same frames without them."""
    both = [name for name in labels if name in seen]
    together = {name: _together(labels[name], seen[name]) for name in both}
    if found := _other_row(labels, seen, together):
        return (found,)
    doubts = [
        _swapped(labels, seen, together, x, y) for x, y in _PAIRS if x in together and y in together
    ]
    doubts += [_unit_or_sign(name, labels[name], seen[name], together[name]) for name in both]
    return tuple(doubt for doubt in doubts if doubt)


def _unit_or_sign(name: str, label: F64, seen: F64, together: float) -> Suspicion | None:
    if not abs(together) >= _TOGETHER:
        return None
    use = _known(label, seen)
    span, factor = float(np.ptp(label[use])), float(seen[use].std() / label[use].std())
    if not 1 / _FACTOR < factor < _FACTOR:
        units = _UNITS[name.rpartition("_")[2]]
        return suspicion(
            SuspicionCode.LABEL_UNIT,
            impossible=nearest(factor, units, _UNIT_WITHIN) is not None,
            name=name,
            span=span,
            factor=factor,
            expected=name.rpartition("_")[2],
            unit=nearest(factor, units, _FACTOR),
        )
    return suspicion(SuspicionCode.LABEL_SIGN, name=name) if together < 0 else None


def _swapped(
    labels: Columns, seen: Columns, together: Mapping[str, float], x: str, y: str
) -> Suspicion | None:
    crossed = _together(labels[x], seen[y]), _together(labels[y], seen[x])
    if not min(map(abs, crossed)) >= _TOGETHER:
        return None
    if max(abs(together[x]), abs(together[y])) >= _APART:
        return None
    return suspicion(SuspicionCode.LABELS_SWAPPED, name=x, other=y)


def _other_row(labels: Columns, seen: Columns, together: Mapping[str, float]) -> Suspicion | None:
    """That each frame has its neighbour's labels; None if some go with the frame itself."""
    if not any(np.isfinite(one) for one in together.values()):
        return None
    if any(abs(one) >= _APART for one in together.values()):
        return None
    for by, row in ((1, "before"), (-1, "after")):
        shifted = [_together(labels[name], np.roll(seen[name], by)) for name in together]
        if any(abs(one) >= _TOGETHER for one in shifted):
            return suspicion(SuspicionCode.LABELS_SHIFTED, impossible=True, row=row)
    return None


def _together(label: F64, seen: F64) -> float:
    """The correlation of two columns; NaN if they show none."""
    use = _known(label, seen)
    if np.count_nonzero(use) < ROWS_LEAST:
        return np.nan
    a, b = label[use] - label[use].mean(), seen[use] - seen[use].mean()
    size = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / size if size > 0 else np.nan


def _known(label: F64, seen: F64) -> Bool:
    return np.asarray(np.isfinite(label) & np.isfinite(seen))
