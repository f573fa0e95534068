"""Solve the contact problems of `skin` and `drag` on a grid, by projected red-black over-relaxation."""

from __future__ import annotations

import math

import cv2
import numpy as np

from tacshade_edge.types import F32

_SOLVE_TOLERANCE_MM = 1e-4
_AROUND = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
_SWEEPS = 400
_TOLERANCE_MM = 1e-3
_RELAXATION = 1.7


def solve(obstacle: F32, mass: F32) -> F32:
    """Solve by projected red-black over-relaxation, starting on a quarter of the nodes; h = 0 on the border."""
    height = obstacle.copy()
    if min(obstacle.shape) >= 24:
        coarse = solve(np.ascontiguousarray(obstacle[::2, ::2]), np.ascontiguousarray(mass[::2, ::2]) * 4)
        rows, cols = obstacle.shape
        # Node (2i, 2j) of the fine grid is node (i, j) of the coarse one.
        to_coarse = np.array(((0.5, 0, 0), (0, 0.5, 0)))
        fine = cv2.warpAffine(
            coarse,
            to_coarse,
            (cols, rows),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
        )
        height = np.maximum(obstacle, fine)
    height[0] = height[-1] = 0
    height[:, 0] = height[:, -1] = 0
    jacobi = 4 / (4 + float(mass.min()))
    omega = np.float32(2 / (1 + math.sqrt(1 - jacobi * jacobi)))
    gain = omega / (4 + mass)
    keep = np.float32(1) - omega
    rows, cols = height.shape
    # Nodes of even and odd rows and columns are stored apart, so that a node's neighbours are contiguous.
    apart = [[np.ascontiguousarray(height[i::2, j::2]) for j in (0, 1)] for i in (0, 1)]
    planes = []
    for i, j in ((1, 1), (2, 2), (1, 2), (2, 1)):
        r, c = slice(i, rows - 1, 2), slice(j, cols - 1, 2)
        around = [_part(apart, i + di, j + dj, height[r, c].shape) for di, dj in _AROUND]
        planes.append((*around, np.ascontiguousarray(gain[r, c]), np.ascontiguousarray(obstacle[r, c])))
    for sweep in range(600):
        check = sweep % 8 == 7
        change = 0.0
        for centre, north, south, west, east, g, floor in planes:
            new = north + south
            new += west
            new += east
            new *= g
            new += keep * centre
            np.maximum(new, floor, out=new)
            if check and new.size:
                change = max(change, float(np.max(np.abs(new - centre))))
            centre[...] = new
        if check and change < _SOLVE_TOLERANCE_MM * (2 - omega):
            break
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        height[i::2, j::2] = apart[i][j]
    return height


def _part(apart: list[list[F32]], row: int, col: int, shape: tuple[int, int]) -> F32:
    """Every other node, starting at (row, col)."""
    there = apart[row % 2][col % 2]
    return there[row // 2 : row // 2 + shape[0], col // 2 : col // 2 + shape[1]]


def slid(held: F32, limit: F32, mass: F32) -> F32:
    """Solve (4 + m) w - sum of the neighbours = r with |r| up to a limit (above 0 where something touches) for w (2,
    rows, cols), 0 on the border and `held` where the limit allows it, by projected red-black over-relaxation that
    starts on a quarter of the nodes.
    """
    rows, cols = mass.shape
    if min(mass.shape) >= 24:
        coarse = slid(*(np.ascontiguousarray(a[..., ::2, ::2]) for a in (held, limit * 4, mass * 4)))
        w = np.where(limit > 0, held, finer(coarse, mass.shape))
    else:
        w = held.copy()
    w[:, 0] = w[:, -1] = 0
    w[:, :, 0] = w[:, :, -1] = 0
    planes = []
    for i, j in ((1, 1), (2, 2), (1, 2), (2, 1)):
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
    for _ in range(_SWEEPS):
        change = 0.0
        for centre, neighbours, stuck, most, gain in planes:
            total = neighbours[0] + neighbours[1]
            total += neighbours[2]
            total += neighbours[3]
            traction = stuck - total
            size = np.sqrt(traction[0] ** 2 + traction[1] ** 2)
            traction *= np.minimum(most / np.maximum(size, 1e-12), 1)
            total += traction
            total *= gain
            total -= centre
            change = max(change, float(np.abs(total).max(initial=0)))
            centre += np.float32(_RELAXATION) * total
        if change < _TOLERANCE_MM * (2 - _RELAXATION):
            break
    return w


def finer(coarse: F32, shape: tuple[int, int]) -> F32:
    """Resample (2, rows, cols) to a grid with half the step: its node (2i, 2j) is node (i, j) of the coarse one."""
    to_coarse = np.array(((0.5, 0, 0), (0, 0.5, 0)))
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.stack(
        [cv2.warpAffine(c, to_coarse, shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE) for c in coarse]
    )
