"""Rows of a table against what the picture of each shows: whether they belong together.

Each row is compared with each picture. Where the rows disagree with their own pictures, and agree
with those that another order gives them, that is the order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from typing import Any, Final

import numpy as np

from tacshade_edge.plausibility.suspicions import Suspicion, SuspicionCode, suspicion
from tacshade_edge.types import F64, I64

ROWS_LEAST: Final = 8
# Mean disagreement, from 0 to 1. Rows disagree with their own pictures by more than the first, and
# in the right order by no more than the second and this part of that: honest tables have 0.4 at
# most, rows of others 0.7 and more.
_APART, _TOGETHER, _PART = 0.5, 0.42, 0.6
# More rows are not matched: any picture finds one that is like it.
_MATCHED_MOST: Final = 200


class Order(StrEnum):
    """How images may have the values of others, as a question ends."""

    BEFORE = "does each image have the values of the row before?"
    AFTER = "does each image have the values of the row after?"
    REVERSED = "are the images in the opposite order?"
    BY_TEXT = "are the images sorted as text, 10 before 2, and the values by number?"
    BY_NUMBER = "are the images sorted by number, and the values as text, 10 before 2?"
    OTHER = "are the images in another order?"


def name_orders(names: Sequence[str], by_number: Callable[[str], Any]) -> dict[Order, I64]:
    """The row of each image's values if images or values were sorted by name, and the others by
    another key than text.
    """
    orders = dict[Order, I64]()
    if len(set(names)) < len(names):
        return orders
    for order, key in ((Order.BY_TEXT, by_number), (Order.BY_NUMBER, str)):
        rank = {name: k for k, name in enumerate(sorted(names, key=key))}
        orders[order] = np.array([rank[name] for name in names], np.int64)
    return orders


def judge_rows(stated: F64, seen: F64, explained: float = 1.0) -> Suspicion | None:
    """What is wrong with the order of rows (N, Q), judging by what the picture of each shows, both
    in units of what is far apart; NaN where unknown.

    `explained`: the disagreement that another mistake leaves, which is the likelier one if it
    leaves as little.
    """
    known = np.flatnonzero(np.isfinite(seen).any(axis=1))
    as_stated = disagreement(stated, seen)
    if len(known) < ROWS_LEAST or as_stated < _APART or explained <= _TOGETHER:
        return None
    most = min(_TOGETHER, _PART * as_stated)
    count = len(stated)
    orders = {
        Order.BEFORE: (known + 1) % count,
        Order.AFTER: (known - 1) % count,
        Order.REVERSED: count - 1 - known,
    }
    left = {order: _cost(stated[rows], seen[known]) for order, rows in orders.items()}
    best = min(left, key=lambda order: left[order])
    if left[best] >= most and count <= _MATCHED_MOST:
        best = Order.OTHER
        left[best], orders[best] = _matched(stated, seen[known])
        # Rows that have nothing to do with the pictures match them as well when they are mirrored.
        most = min(most, *(_PART * _matched(each, seen[known])[0] for each in _mirrored(stated)))
    if left[best] >= most:
        return None
    first = int(np.argmax(orders[best] != known))
    return suspicion(
        SuspicionCode.ROWS_OF_OTHERS,
        impossible=True,
        order=best,
        image=int(known[first]),
        row=int(orders[best][first]),
    )


def disagreement(stated: F64, seen: F64) -> float:
    """How much rows disagree with their own pictures, 0 to 1; 1 if nothing is known."""
    known = np.isfinite(seen).any(axis=1)
    return _cost(stated[known], seen[known]) if known.any() else 1.0


def _matched(stated: F64, seen: F64) -> tuple[float, I64]:
    """How much the rows disagree with pictures if each gets the row that is best for all, no row
    twice; and these rows.
    """
    from scipy.optimize import linear_sum_assignment  # a daemon never has a table

    apart = _apart(stated[None], seen[:, None])
    pictures, rows = linear_sum_assignment(apart)
    return float(apart[pictures, rows].mean()), np.asarray(rows, np.int64)


def _mirrored(stated: F64) -> Iterator[F64]:
    """The rows with one quantity after the other mirrored in its middle."""
    for k in range(stated.shape[1]):
        made = stated.copy()
        if np.isfinite(made[:, k]).any():
            made[:, k] = np.nanmin(made[:, k]) + np.nanmax(made[:, k]) - made[:, k]
        yield made


def _cost(stated: F64, seen: F64) -> float:
    return float(_apart(stated, seen).mean())


def _apart(stated: F64, seen: F64) -> F64:
    """How much rows (..., Q) disagree with pictures: by the quantity that does most of those that
    both know; 1 if there is none.
    """
    squared = np.minimum(1.0, (seen - stated) ** 2)
    most = np.where(np.isnan(squared), -1.0, squared).max(axis=-1)
    return np.where(most < 0, 1.0, most)
