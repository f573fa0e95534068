"""The motion of an object through the stops of a path, in steps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.lab.simulator.press import Press
from tacshade_edge.types import F64

_GRADIENT_MM = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """An object whose origin is at a place (3,) of the sensor frame, in mm."""

    press: Press
    radius_mm: float
    at_mm: F64

    def distance_mm(self, points_mm: F64) -> F64:
        """Signed distances (N,) of points (N, 3)."""
        return self.press.distance_mm(
            self.radius_mm, points_mm - self.at_mm + _origin(self.press, self.radius_mm)
        )

    def normals(self, points_mm: F64) -> F64:
        """Unit vectors (N, 3) away from the object."""
        normal = np.stack(
            [
                self.distance_mm(points_mm + axis) - self.distance_mm(points_mm - axis)
                for axis in _GRADIENT_MM * np.eye(3)
            ],
            axis=1,
        )
        return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)


def moves(
    radius_mm: float, stops: Sequence[Press], lifted_mm: float, step_mm: float
) -> Iterator[list[tuple[Pose, F64]]]:
    """The poses on the way to each stop, and the motion (3,) to each of them,
    from above the first stop.
    """
    at = _origin(stops[0], radius_mm) + np.array((0, 0, lifted_mm))
    for stop in stops:
        to = _origin(stop, radius_mm)
        count = max(1, math.ceil(float(np.linalg.norm(to - at)) / step_mm))
        by = (to - at) / count
        yield [(Pose(stops[0], radius_mm, at + k * by), by) for k in range(1, count + 1)]
        at = to


def clearance_mm(rest_mm: F64, radius_mm: float, press: Press) -> float:
    """By how much a pressed object must be lifted to be free of points (N, 3)."""
    low, high = 0.0, radius_mm
    for _ in range(20):
        middle = (low + high) / 2
        free = float(press.distance_mm(radius_mm, rest_mm - (0, 0, middle)).min()) > 0
        low, high = (low, middle) if free else (middle, high)
    return high


def _origin(press: Press, radius_mm: float) -> F64:
    return np.array((press.x_mm, press.y_mm, press.origin_z_mm(radius_mm)))
