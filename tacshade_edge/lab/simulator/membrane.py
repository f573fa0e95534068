"""The membrane on its elastic foundation, solved on a grid: normal to itself and along itself.

Both problems are relaxed by projected red-black over-relaxation, each from the solution on a
quarter of the nodes, or from one that is known to be near. Maps are float32 (rows, cols); a mass
weight is (step / decay)², times the factor of the chart (`skin.mass_weight`).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np

from tacshade_edge.types import F32

_COARSEST = 24
"""A grid with fewer nodes on a side is solved as it is."""
_AROUND = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
# The border is held at 0, so each colour begins one node inside it.
_RED, _BLACK = ((1, 1), (2, 2)), ((1, 2), (2, 1))

_SOLVE_SWEEPS = 600
_SOLVE_CHECKS = 8
"""Only every so many sweeps measure the change, which takes another pass over the nodes."""
_SOLVE_TOLERANCE_MM = 1e-4

_SLIDE_SWEEPS = 400
_SLIDE_TOLERANCE_MM = 1e-3
_SLIDE_RELAXATION = 1.7

# Node (2i, 2j) of a fine grid is node (i, j) of the coarse one, so halving maps one to the other
# without the half node by which cv2.resize, which aligns the outlines of pixels, would shift it.
_TO_COARSE = np.array(((0.5, 0, 0), (0, 0.5, 0)))
_UPSAMPLING = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP

Slide = Callable[[F32, F32, F32, F32], object]
"""Relaxes w in place, from `held`, `limit` and `mass`."""


def solve(obstacle: F32, mass: F32, near: F32 | None = None) -> F32:
    """Solve (4 + m) h >= the sum of the neighbours, h >= obstacle, one of them with equality;
    h = 0 on the border. It begins with `near`, if given: the solution of a similar problem.
    """
    height = obstacle.copy()
    if near is not None:
        np.maximum(obstacle, near, out=height)
    elif min(obstacle.shape) >= _COARSEST:
        # Twice the step: the mass weight, which goes with its square, is four times as large.
        coarse = solve(
            np.ascontiguousarray(obstacle[::2, ::2]), np.ascontiguousarray(mass[::2, ::2]) * 4
        )
        fine = cv2.warpAffine(
            coarse,
            _TO_COARSE,
            obstacle.shape[::-1],
            flags=_UPSAMPLING,
            borderMode=cv2.BORDER_CONSTANT,
        )
        height = np.maximum(obstacle, fine)
    height[0] = height[-1] = 0
    height[:, 0] = height[:, -1] = 0
    _settle(height, obstacle, mass)
    return height


def _settle(height: F32, obstacle: F32, mass: F32) -> None:
    """Relax a height in place until it hardly changes."""
    # The best factor for the least mass, whose errors decay slowest (Young 1971); where the mass
    # is larger it relaxes too far, yet converges.
    jacobi = 4 / (4 + float(mass.min()))
    omega = np.float32(2 / (1 + math.sqrt(1 - jacobi * jacobi)))
    keep = np.float32(1) - omega
    # Nodes of even and odd rows and columns are stored apart,
    # so that a node's neighbours are contiguous.
    apart = [[np.ascontiguousarray(height[i::2, j::2]) for j in (0, 1)] for i in (0, 1)]
    planes = _planes(apart, omega / (4 + mass), obstacle)
    for sweep in range(1, _SOLVE_SWEEPS + 1):
        check = sweep % _SOLVE_CHECKS == 0
        change = 0.0
        for centre, north, south, west, east, gain, floor in planes:
            new = north + south
            new += west
            new += east
            new *= gain
            new += keep * centre
            np.maximum(new, floor, out=new)
            if check and new.size:
                change = max(change, float(np.max(np.abs(new - centre))))
            centre[...] = new
        # The nearer omega is to 2, the more sweeps an error still needs after so small a change.
        if check and change < _SOLVE_TOLERANCE_MM * (2 - omega):
            break
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        height[i::2, j::2] = apart[i][j]


def _planes(apart: list[list[F32]], gain: F32, obstacle: F32) -> list[tuple[F32, ...]]:
    """Views of every other node inside the border and of its neighbours, first those of one colour,
    then those of the other; with its gain and its obstacle.
    """
    rows, cols = obstacle.shape
    planes: list[tuple[F32, ...]] = []
    for i, j in (*_RED, *_BLACK):
        inside = slice(i, rows - 1, 2), slice(j, cols - 1, 2)
        floor = np.ascontiguousarray(obstacle[inside])
        around = [_part(apart, i + di, j + dj, floor.shape) for di, dj in _AROUND]
        planes.append((*around, np.ascontiguousarray(gain[inside]), floor))
    return planes


def _part(apart: list[list[F32]], row: int, col: int, shape: tuple[int, ...]) -> F32:
    """Every other node, starting at (row, col)."""
    there = apart[row % 2][col % 2]
    return there[row // 2 : row // 2 + shape[0], col // 2 : col // 2 + shape[1]]


def _slide(w: F32, held: F32, limit: F32, mass: F32) -> None:
    """Relax by projected red-black over-relaxation."""
    rows, cols = mass.shape
    planes = []
    for i, j in (*_RED, *_BLACK):
        r, c = slice(i, rows - 1, 2), slice(j, cols - 1, 2)
        near = (
            (slice(i - 1, rows - 2, 2), c),
            (slice(i + 1, rows, 2), c),
            (r, slice(j - 1, cols - 2, 2)),
            (r, slice(j + 1, cols, 2)),
        )
        diagonal = np.ascontiguousarray(4 + mass[r, c])
        planes.append(
            (
                w[:, r, c],
                [w[:, *n] for n in near],
                held[:, r, c] * diagonal,
                np.ascontiguousarray(limit[r, c]),
                1 / diagonal,
            )
        )
    for _ in range(_SLIDE_SWEEPS):
        change = 0.0
        for centre, neighbours, stuck, most, gain in planes:
            total = neighbours[0] + neighbours[1]
            total += neighbours[2]
            total += neighbours[3]
            # What would hold the node where it sticks; Coulomb takes as much of it as the pressure
            # allows.
            traction = stuck - total
            size = np.sqrt(traction[0] ** 2 + traction[1] ** 2)
            traction *= np.minimum(most / np.maximum(size, 1e-12), 1)
            total += traction
            total *= gain
            total -= centre
            change = max(change, float(np.abs(total).max(initial=0)))
            centre += np.float32(_SLIDE_RELAXATION) * total
        if change < _SLIDE_TOLERANCE_MM * (2 - _SLIDE_RELAXATION):
            break


def slid(held: F32, limit: F32, mass: F32, relax: Slide = _slide, near: F32 | None = None) -> F32:
    """Solve (4 + m) w - sum of the neighbours = r with |r| up to a limit (above 0 where something
    touches) for w (2, rows, cols), 0 on the border and `held` where the limit allows it, by
    relaxation that starts on a quarter of the nodes, or with `near`, as in `solve`.
    """
    if near is not None:
        w = near.copy()
    elif min(mass.shape) >= _COARSEST:
        # As with the mass, a limit is per node, and a coarse node stands for four.
        few = [np.ascontiguousarray(each[..., ::2, ::2]) for each in (held, limit * 4, mass * 4)]
        coarse = slid(few[0], few[1], few[2], relax)
        w = np.where(limit > 0, held, finer(coarse, mass.shape))
    else:
        w = held.copy()
    # Coarse grids end elsewhere, so the border is cleared after the resampling.
    w[:, 0] = w[:, -1] = 0
    w[:, :, 0] = w[:, :, -1] = 0
    relax(w, held, limit, mass)
    return w


def finer(coarse: F32, shape: tuple[int, int]) -> F32:
    """Resample (2, rows, cols) to a grid with half the step."""
    return np.stack(
        [
            cv2.warpAffine(
                each, _TO_COARSE, shape[::-1], flags=_UPSAMPLING, borderMode=cv2.BORDER_REPLICATE
            )
            for each in coarse
        ]
    )
