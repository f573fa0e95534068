"""A grid of quadrangles on a dome: a square in the middle, with rings around it."""

from __future__ import annotations

import itertools
import math

import numpy as np

from tacshade_edge.types import F64, I64

RIM_DEG = 72.0
"""Angle at O from the tip to the rim."""
SQUARE = 9
RINGS = 11
"""Half the number of quadrangles along a side of the square, and the number of rings."""
SQUARE_DEG, GROWTH, ROUNDNESS = 27.0, 1.08, 0.6
"""Half the side of the square, by how much each ring is wider than the one before, and how far the
square's outline follows a circle (1: wholly).
"""


def directions(
    square: int = SQUARE, rings: int = RINGS, rim_deg: float = RIM_DEG
) -> tuple[F64, I64]:
    """Make unit directions (N, 3), the last of which are at the rim, and quadrangles (M,
    4) between them.
    """
    flat, quads = _plane(square, rings, rim_deg)
    angle, around = np.radians(np.linalg.norm(flat, axis=1)), np.arctan2(flat[:, 1], flat[:, 0])
    out = np.sin(angle)
    return np.stack((out * np.cos(around), out * np.sin(around), np.cos(angle)), axis=1), quads


def _plane(square: int, rings: int, rim_deg: float) -> tuple[F64, I64]:
    """Points (N, 2), whose distance from the middle is an angle in degrees, and quadrangles."""
    points: list[tuple[float, float]] = []
    index: dict[tuple[int, int], int] = {}
    for i, j in itertools.product(range(-square, square + 1), repeat=2):
        index[i, j] = len(points)
        points.append(_rounded(i / square, j / square))
    quads = [
        [index[i, j], index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]]
        for i, j in itertools.product(range(-square, square), repeat=2)
    ]
    side = range(-square, square)
    edge = [(k, -square) for k in side] + [(square, k) for k in side]
    edge += [(-k, square) for k in side] + [(-square, -k) for k in side]
    inner = [index[at] for at in edge]
    steps = np.cumsum(GROWTH ** np.arange(rings)) / np.sum(GROWTH ** np.arange(rings))
    start = np.array([points[k] for k in inner])
    end = rim_deg * start / np.linalg.norm(start, axis=1, keepdims=True)
    for part in steps:
        outer = list(range(len(points), len(points) + len(inner)))
        points += [(x, y) for x, y in start + part * (end - start)]
        for k in range(len(inner)):
            after = (k + 1) % len(inner)
            quads.append([inner[k], outer[k], outer[after], inner[after]])
        inner = outer
    return np.array(points), np.array(quads, dtype=np.int64)


def _rounded(x: float, y: float) -> tuple[float, float]:
    far, length = max(abs(x), abs(y)), math.hypot(x, y)
    scale = SQUARE_DEG * (
        1 if length == 0 else (1 - ROUNDNESS * far) + ROUNDNESS * far * far / length
    )
    return scale * x, scale * y
