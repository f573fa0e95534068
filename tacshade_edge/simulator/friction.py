"""Coulomb's law on a grid: the solver of the tangential problem in `drag`."""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.types import F32

_SWEEPS = 400
_TOLERANCE_MM = 1e-3
_RELAXATION = 1.7


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
