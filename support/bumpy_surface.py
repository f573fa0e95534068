"""A smooth surface and the points that exact presses touch:
for tests of stitching without images.
"""

from __future__ import annotations

import math

import numpy as np

from tacshade_edge.rigid import Rigid, from_seven, shift, turn
from tacshade_edge.stitching.press_points import PressPoints
from tacshade_edge.types import F64

APEX_MM = 20.0
DOWN = from_seven((0, 0, 0, 0, 1, 0, 0))


def height_mm(x: F64, y: F64) -> F64:
    return np.asarray(0.8 * np.sin(x / 2.5) * np.cos(y / 3.0) + 0.02 * x)


def grid_poses(side_mm: float = 30.0, step_mm: float = 5.0) -> list[Rigid]:
    """Poses straight down, with the apex on the surface's mean height."""
    places = np.arange(0, side_mm + 1e-9, step_mm).tolist()
    return [shift(x, y, APEX_MM) @ DOWN for y in places for x in places]


def press_of(pose: Rigid, seed: int, radius_mm: float = 5.0, noise_mm: float = 0.03) -> PressPoints:
    """Points around the apex, on the surface."""
    rng = np.random.default_rng(seed)
    x0, y0, _ = pose.apply(np.array((0, 0, APEX_MM)))
    rho, angle = radius_mm * np.sqrt(rng.uniform(size=600)), rng.uniform(0, 2 * math.pi, 600)
    x, y = x0 + rho * np.cos(angle), y0 + rho * np.sin(angle)
    z = height_mm(x, y) + rng.normal(0, noise_mm, x.shape)
    points = pose.inverse().apply(np.stack((x, y, z), axis=1))
    normals = np.broadcast_to(np.array((0, 0, 1), np.float32), points.shape)
    return PressPoints(points.astype(np.float32), normals, np.ones(len(points), np.float32))


def misreported(poses: list[Rigid], seed: int, mm: float = 0.3, deg: float = 0.6) -> list[Rigid]:
    """Poses with independent Gaussian errors in every axis, about the apex."""
    rng = np.random.default_rng(seed)
    reported = []
    for pose in poses:
        rotation = turn(np.radians(deg) * rng.standard_normal(3))
        there = pose @ shift(0, 0, APEX_MM) @ rotation @ shift(0, 0, -APEX_MM)
        reported.append(shift(*(mm * rng.standard_normal(3)).tolist()) @ there)
    return reported
