"""The solver of the obstacle problem in `skin`."""

from __future__ import annotations

import math

import cv2
import numpy as np

from tacshade_edge.types import F32

_SOLVE_TOLERANCE_MM = 1e-4


def solve(obstacle: F32, mass: F32) -> F32:
    """Projected red-black over-relaxation, begun on a grid of a quarter of the nodes. h = 0 on the border."""
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
    planes = []
    for i, j in ((1, 1), (2, 2), (1, 2), (2, 1)):
        r, c = slice(i, rows - 1, 2), slice(j, cols - 1, 2)
        up, down = slice(i - 1, rows - 2, 2), slice(i + 1, rows, 2)
        left, right = slice(j - 1, cols - 2, 2), slice(j + 1, cols, 2)
        centre = height[r, c]
        planes.append(
            (centre, height[up, c], height[down, c], height[r, left], height[r, right],
             np.ascontiguousarray(gain[r, c]), np.ascontiguousarray(obstacle[r, c]), np.empty_like(centre, order="C"))
        )  # fmt: skip
    for sweep in range(600):
        check = sweep % 8 == 7
        change = 0.0
        for centre, north, south, west, east, g, floor, new in planes:
            np.add(north, south, out=new)
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
    return height
