"""`simulator.skin.solve`, compiled, because a training set needs a hundred thousand solutions."""

from __future__ import annotations

import math

import numba
import numpy as np

from tacshade_edge.types import F32

TOLERANCE_MM = 5e-4
SWEEPS = 600


def solve(obstacle: F32, mass: F32) -> F32:
    """Solve like `simulator.skin.solve`, within `TOLERANCE_MM`."""
    height = obstacle.copy()
    if min(obstacle.shape) >= 24:
        coarse = solve(np.ascontiguousarray(obstacle[::2, ::2]), np.ascontiguousarray(mass[::2, ::2]) * 4)
        _refine(coarse, height)
    height[0] = height[-1] = 0
    height[:, 0] = height[:, -1] = 0
    # Stiffness varies, and the least stiffness would over-relax all other nodes.
    jacobi = 4 / (4 + float(np.median(mass)))
    omega = 2 / (1 + math.sqrt(1 - jacobi * jacobi))
    _relax(height, obstacle, 1 / (4 + mass), np.float32(omega), np.float32(TOLERANCE_MM * (2 - omega)))
    return height


@numba.njit(cache=True, fastmath=True)
def _refine(coarse, fine):  # type: ignore[no-untyped-def]
    """Raise `fine` to the coarse grid's values between its nodes."""
    for i in range(fine.shape[0]):
        for j in range(fine.shape[1]):
            a, b = i // 2, j // 2
            c, d = min(a + i % 2, coarse.shape[0] - 1), min(b + j % 2, coarse.shape[1] - 1)
            value = (coarse[a, b] + coarse[c, b] + coarse[a, d] + coarse[c, d]) * np.float32(0.25)
            fine[i, j] = max(fine[i, j], value)


@numba.njit(cache=True, fastmath=True)
def _relax(height, obstacle, gain, omega, tolerance):  # type: ignore[no-untyped-def]
    """Relax by projected red-black over-relaxation."""
    rows, cols = height.shape
    for _ in range(SWEEPS):
        change = np.float32(0)
        for colour in range(2):
            for i in range(1, rows - 1):
                for j in range(1 + (i + colour) % 2, cols - 1, 2):
                    old = height[i, j]
                    total = height[i - 1, j] + height[i + 1, j] + height[i, j - 1] + height[i, j + 1]
                    new = max(old + omega * (total * gain[i, j] - old), obstacle[i, j])
                    change = max(change, abs(new - old))
                    height[i, j] = new
        if change < tolerance:
            break
