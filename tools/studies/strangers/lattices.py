"""Where pins lie: lattices in the equal-area chart of a sphere, as unit directions."""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.lab.simulator.render import equal_area_to_direction
from tacshade_edge.types import F64

_GOLDEN_RAD = math.pi * (3 - math.sqrt(5))


def reach(half_angle_deg: float) -> float:
    """How far a print reaches in the equal-area chart of a unit sphere."""
    return 2 * math.sin(math.radians(half_angle_deg + 5) / 2)


def hexagonal(pitch: float, far: float, turn_rad: float) -> tuple[F64, F64]:
    """Corners and the middles of triangles of a hexagonal lattice, (N, 2) each,
    on a chart of a unit sphere.
    """
    n = math.ceil(far / pitch / 0.86) + 1
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    corner = np.stack(((i + 0.5 * j).ravel(), (j * math.sqrt(0.75)).ravel()), axis=1) * pitch
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    turn = np.array(((c, s), (-s, c)))
    third = np.array((0.5, math.sqrt(1 / 12))) * pitch
    return corner @ turn, np.concatenate((corner + third, corner - third)) @ turn


def spiral(pitch: float, far: float, turn_rad: float) -> F64:
    """A sunflower with the density of a hexagonal lattice, (N, 2)."""
    count = int(math.pi * far**2 / (pitch**2 * math.sqrt(0.75)))
    k = np.arange(count)
    rho, angle = far * np.sqrt((k + 0.5) / count), k * _GOLDEN_RAD + turn_rad
    return np.stack((rho * np.cos(angle), rho * np.sin(angle)), axis=1)


def rings(pitch: float, far: float, turn_rad: float) -> tuple[F64, F64]:
    """Concentric rings, and points between the rings, (N, 2) each."""
    made, between = [np.zeros((1, 2))], []
    for k in range(1, math.ceil(far / pitch) + 1):
        count = 6 * k
        angle = turn_rad * k + 2 * math.pi * np.arange(count) / count
        half = angle + math.pi / count
        made.append(k * pitch * np.stack((np.cos(angle), np.sin(angle)), axis=1))
        between.append((k - 0.5) * pitch * np.stack((np.cos(half), np.sin(half)), axis=1))
    return np.concatenate(made), np.concatenate(between)


def on_sphere(chart: F64, far: float, jitter: float, rng: np.random.Generator) -> F64:
    """Directions (N, 3) of the points within reach, each moved at random."""
    moved = chart + rng.normal(0, jitter, chart.shape)
    return equal_area_to_direction(moved[np.linalg.norm(moved, axis=1) < far], 1.0)
