"""How far objects reach into the undeformed skin, by the depths of its taxels. Pure.

MuJoCo gives the distance of each taxel to the nearest surface of the object that it lies in. The
skin's mechanics need where a column of them leaves the object: between the last one inside and the
next, where the depth runs out. Beside a wall, the depth tells how far the wall is instead, and
leaves a range, in which the columns around tell more.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from tacshade_edge.lab.mjcf.taxels import Taxels
from tacshade_edge.types import F32, F64, I64, Bool

# All in steps from one taxel of a column to the next.
_LEAST_SLOPE: Final = 0.3
"""Depth that hardly falls, or has only just begun to, is that of a wall."""
_STRAIGHT: Final = 0.9
"""So fast, the depth falls towards a face that a column meets."""
_BENT: Final = -1e-3
"""The second difference of depths that lie on no straight line is less."""
_ROUND: Final = 0.03
"""A fourth depth so near to a ball through three is that of something round, not of a wall."""
_WALL_CELLS: Final = 2
"""So many cells deep, a wall may be nearer than the object's end."""
_AROUND: Final = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]


def reached_mm(taxels: Taxels, depth_mm: F64) -> tuple[F32, F32]:
    """How far objects reach into the undeformed skin at each cell, float32 (rows, cols), from the
    taxels' depths (shells, N), and how far at most; 0 where none does. They differ only beside
    walls.
    """
    shape = taxels.grid.rows, taxels.grid.cols
    least, most = np.zeros((2, *shape), np.float32)
    # What only the shell outside feels does not touch the undeformed skin.
    felt = np.flatnonzero((depth_mm[1:] > 0).any(axis=0))
    gap = float(taxels.below_mm[1] - taxels.below_mm[0])
    last, low, high = _ends(depth_mm[:, felt] / gap)
    least.flat[taxels.cell[felt]] = taxels.below_mm[last] + gap * low
    most.flat[taxels.cell[felt]] = taxels.below_mm[last] + gap * high
    return _as_around(least, most), most


def _ends(depth: F64) -> tuple[I64, F64, F64]:
    """Where columns of depths (shells, N) leave an object: each one's last taxel inside, and how
    far beyond it the object ends, at least and at most.
    """
    shells = len(depth)
    last = shells - 1 - np.argmax(depth[::-1] > 0, axis=0)
    column = np.arange(len(last))
    here, before, earlier, first = (depth[np.maximum(last - k, 0), column] for k in range(4))
    fall = before - here
    radius, middle, round_end = _ball_through(here, before, earlier)
    bent = (last > 1) & (fall > earlier - before - _BENT)
    # What the ball's depth would be at the fourth taxel, three steps before the last.
    fourth = radius - np.sqrt(np.maximum((radius - here) ** 2 + 9 + 6 * middle, 0))
    # Its end must lie before the next taxel, which is outside.
    is_round = bent & (last - 3 >= 0) & (round_end < 1) & (np.abs(fourth - first) < _ROUND)
    wall = (fall < _LEAST_SLOPE) | ((last > 1) & (earlier - before < _LEAST_SLOPE))
    # Of two taxels inside, the outer one may have a wall near.
    wall |= (last == 1) & (fall < _STRAIGHT)
    wall &= ~is_round & (last < shells - 1)
    flat_end = here / np.maximum(fall, _LEAST_SLOPE)
    end = np.where(bent, round_end, flat_end)
    # Depth is a distance, and falls by a step per step at most, in a convex object ever faster. The
    # next taxel is outside, but the last shell has none.
    most = np.where(wall, here / np.maximum(fall, 1e-9), end)
    next_one = np.where(last < shells - 1, 1.0, np.inf)
    low, high = (
        np.minimum(np.maximum(each, here), next_one) for each in (np.where(wall, here, end), most)
    )
    return last, low, high


def _ball_through(here: F64, before: F64, earlier: F64) -> tuple[F64, F64, F64]:
    """The ball that explains a column's last three depths: its radius, where its middle lies along
    the column, and where it ends, from the last taxel.
    """
    # (radius - depth)² - (place - middle)² is the same at all three.
    bend = np.minimum(here - 2 * before + earlier, _BENT)
    radius = (here**2 - 2 * before**2 + earlier**2 - 2) / (2 * bend)
    middle = radius * (here - before) - (here**2 - before**2 + 1) / 2
    end = middle + np.sqrt(np.maximum(middle**2 + 2 * radius * here - here**2, 0))
    return radius, middle, end


def _as_around(least: F32, most: F32) -> F32:
    """Choose between the least and the most, beside a wall, what continues the cells around."""
    likely, unknown = least.copy(), most > least
    for _ in range(_WALL_CELLS):
        if not unknown.any():
            break
        found = unknown & ~np.isnan(around := _continued(likely, (least > 0) & ~unknown))
        likely[found] = np.clip(around, least, most)[found]
        unknown &= ~found
    return likely


def _continued(reached: F32, known: Bool) -> F32:
    """What known cells' values would be, were they to go on straight to each cell: the mean over
    directions with two of them, NaN without.
    """
    rows, cols = reached.shape
    value, weight = (np.pad(each, 2) for each in (reached, known.astype(np.float32)))
    count, total = np.zeros((2, rows, cols), np.float32)
    for i, j in _AROUND:
        near, far = (
            (slice(2 + k * i, 2 + k * i + rows), slice(2 + k * j, 2 + k * j + cols)) for k in (1, 2)
        )
        both = weight[near] * weight[far]
        count += both
        total += both * (2 * value[near] - value[far])
    return np.where(count > 0, total / np.maximum(count, 1), np.float32(np.nan))
