"""Labelled quantities against what the map of the same frames shows without labels.

Correlation does not depend on the unit: where labels and map go together, the ratio of their
spreads is the unit, and the correlation's sign theirs. Where they do not, and a touch model learns
nothing from them either, the labels are of other frames, or the map shows nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from tacshade_edge.plausibility.row_order import Order
from tacshade_edge.plausibility.suspicions import Suspicion, SuspicionCode, suspicion
from tacshade_edge.plausibility.units import ANGLES, LENGTHS, nearest
from tacshade_edge.types import F64, I64, Bool

ROWS_LEAST: Final = 12
# The map of a known kind of sensor goes with depths and tilts by 0.9 and more, and has their spread
# within a half.
_TOGETHER, _APART = 0.8, 0.5
# Labels of other rows may go with frames by chance, but by so much less than with their own.
_FARTHER: Final = 0.3
_FACTOR: Final = 5.0
# A factor this near to a unit's cannot be another mistake.
_UNIT_WITHIN: Final = 2.0
_UNITS: Final = {"mm": LENGTHS, "deg": ANGLES}
_PAIRS: Final = (("tilt_x_deg", "tilt_y_deg"), ("shear_x_mm", "shear_y_mm"))
# What goes with the depth of every touch, however little else a frame shows.
_DEPTH: Final = "depth_mm"
_AS_DEPTH: Final = (_DEPTH, "force_z_n")
# Depths and labels that differ by less than this part of their mean show nothing of each other.
_SPREAD: Final = 0.15
# Correlations of labels at random are below this many of their deviations, 1 / √n.
_CHANCE: Final = 2.5
_ROWS_RANDOM: Final = 30

Columns = Mapping[str, F64]
"""Values of each frame (N,) by quantity; NaN where unknown."""


def judge_labels(
    labels: Columns,
    seen: Columns,
    *,
    learnt: Collection[str] = (),
    orders: Mapping[Order, I64] = MappingProxyType({}),
) -> tuple[Suspicion, ...]:
    """What is wrong with the labels, judging by what is seen of the same frames without them.

    `learnt` are quantities that a model learns from these frames; `orders` the row of each frame's
    labels (N,) in other orders than of the table, by their names.
    """
    both = [name for name in labels if name in seen]
    together = {name: _together(labels[name], seen[name]) for name in both}
    if found := _other_row(labels, seen, together, orders):
        return (found,)
    doubts = [
        _swapped(labels, seen, together, x, y) for x, y in _PAIRS if x in together and y in together
    ]
    doubts += [_unit_or_sign(name, labels[name], seen[name], together[name]) for name in both]
    doubts += [_constant(name, column) for name, column in labels.items()]
    doubts += [
        _unshown(name, labels[name], seen[_DEPTH])
        for name in _AS_DEPTH
        if name in labels and name not in learnt and _DEPTH in seen
    ]
    return tuple(doubt for doubt in doubts if doubt)


def _constant(name: str, label: F64) -> Suspicion | None:
    known = label[np.isfinite(label)]
    if len(known) < ROWS_LEAST or np.ptp(known) > 0:
        return None
    return suspicion(
        SuspicionCode.LABEL_CONSTANT, name=name, value=float(known[0]), rows=len(known)
    )


def _unshown(name: str, label: F64, depth: F64) -> Suspicion | None:
    """That labels go with depths no better than any others would, although both differ."""
    use = _known(label, depth)
    rows = int(np.count_nonzero(use))
    if rows < _ROWS_RANDOM or min(_spread(label[use]), _spread(depth[use])) < _SPREAD:
        return None
    together = _together(label, depth)
    if abs(together) > _CHANCE / np.sqrt(rows):
        return None
    return suspicion(SuspicionCode.LABEL_UNSHOWN, name=name, rows=rows, correlation=together)


def _spread(values: F64) -> float:
    mean = abs(float(values.mean()))
    return float(values.std()) / mean if mean > 0 else np.inf


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


def _other_row(
    labels: Columns, seen: Columns, together: Mapping[str, float], orders: Mapping[Order, I64]
) -> Suspicion | None:
    """That each frame has another's labels; None if some go with the frame itself."""
    as_stated = _most(together.values())
    if not together or as_stated > 1 - _FARTHER:
        return None
    numbers = np.arange(len(next(iter(labels.values()))))
    moved = {
        Order.BEFORE: np.roll(numbers, -1),
        Order.AFTER: np.roll(numbers, 1),
        Order.REVERSED: numbers[::-1],
    }
    for order, rows in {**moved, **orders}.items():
        found = _most(_together(labels[name][rows], seen[name]) for name in together)
        if found >= max(_TOGETHER, as_stated + _FARTHER):
            return suspicion(SuspicionCode.LABELS_SHIFTED, impossible=True, order=order)
    return None


def _most(correlations: Iterable[float]) -> float:
    """The greatest size of those that are known; 0 without any."""
    return max((abs(one) for one in correlations if np.isfinite(one)), default=0.0)


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
