"""The touchpad of the paper's Fig. 7: curves, a circle, fences of several widths and intervals,
two dots.

A plate with its top at z = 0 in the robot's base frame carries bulges with rounded edges. To a
sensor at a pose, the pad is one more object in the sensor frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from tacshade_edge.lab.simulator.press import Shape
from tacshade_edge.rigid import Rigid, from_seven, shift, turn
from tacshade_edge.types import F32, F64

BULGE_HEIGHT_MM = 1.5
EDGE_ROUNDING_MM = 1.0
# From the axis of a sensor; farther bulges are below any skin pressed 3 mm deep.
_REACH_MM = 18.0


@dataclass(frozen=True, slots=True)
class Bar:
    """A straight bulge with square ends; its middle line runs from one point to the other."""

    x0_mm: float
    y0_mm: float
    x1_mm: float
    y1_mm: float
    width_mm: float

    def outline(self, x: F64, y: F64) -> F64:
        """Signed distance in mm in the plane, negative inside."""
        length = math.hypot(self.x1_mm - self.x0_mm, self.y1_mm - self.y0_mm)
        c, s = (self.x1_mm - self.x0_mm) / length, (self.y1_mm - self.y0_mm) / length
        u, v = x - (self.x0_mm + self.x1_mm) / 2, y - (self.y0_mm + self.y1_mm) / 2
        along, across = (
            np.abs(c * u + s * v) - length / 2,
            np.abs(c * v - s * u) - self.width_mm / 2,
        )
        outside = np.hypot(np.maximum(along, 0), np.maximum(across, 0))
        return np.asarray(outside + np.minimum(np.maximum(along, across), 0))


@dataclass(frozen=True, slots=True)
class Arc:
    """A part of a ring with round ends; its middle line runs between two angles,
    measured from x towards y.
    """

    x_mm: float
    y_mm: float
    radius_mm: float
    width_mm: float
    from_deg: float = 0.0
    to_deg: float = 360.0

    def outline(self, x: F64, y: F64) -> F64:
        """Signed distance in mm in the plane, negative inside."""
        half = math.radians(self.to_deg - self.from_deg) / 2
        middle = math.radians(self.from_deg + self.to_deg) / 2
        u, v = x - self.x_mm, y - self.y_mm
        u, v = (
            math.cos(middle) * u + math.sin(middle) * v,
            np.abs(math.cos(middle) * v - math.sin(middle) * u),
        )
        ring = np.abs(np.hypot(u, v) - self.radius_mm)
        if half < math.pi:
            end = np.hypot(u - self.radius_mm * math.cos(half), v - self.radius_mm * math.sin(half))
            ring = np.where(np.arctan2(v, u) <= half, ring, end)
        return np.asarray(ring - self.width_mm / 2)


@dataclass(frozen=True, slots=True)
class Dot:
    """A round bulge."""

    x_mm: float
    y_mm: float
    radius_mm: float

    def outline(self, x: F64, y: F64) -> F64:
        """Signed distance in mm in the plane, negative inside."""
        return np.asarray(np.hypot(x - self.x_mm, y - self.y_mm) - self.radius_mm)


Bulge = Bar | Arc | Dot


@dataclass(frozen=True, slots=True)
class Pad:
    """A plate from (0, 0) to (`width_mm`, `length_mm`) in x and y, with bulges on it."""

    width_mm: float
    length_mm: float
    bulges: tuple[Bulge, ...]

    def height_mm(self, x: F64, y: F64) -> F64:
        """The top's z in mm at points of the plane."""
        return reduce(np.maximum, (_top_mm(b.outline(x, y)) for b in self.bulges), np.zeros_like(x))

    def distance_mm(self, points_mm: F64) -> F64:
        """Signed distance (N,) in mm of points (N, 3) in the base frame, negative inside;
        the plate is infinite.
        """
        return _distance(self.bulges, points_mm)

    def under(self, base_T_sensor: Rigid, apex_mm: float) -> Shape:
        """The pad under a sensor at a pose, for a `Press` of depth 0 at (0, 0), whose origin is the
        apex of the undeformed skin.
        """
        x, y, _ = base_T_sensor.translation_mm
        # Each bulge costs a distance at every node; most are far away.
        near = [
            b for b in self.bulges if float(b.outline(np.array([x]), np.array([y]))[0]) < _REACH_MM
        ]
        apex = np.array((0.0, 0.0, apex_mm))

        def sdf(points: F64) -> F64:
            return _distance(near, base_T_sensor.apply(points + apex)).astype(points.dtype)

        return Shape("pad", sdf)


def _distance(bulges: Sequence[Bulge], p: F64) -> F64:
    nearest = p[:, 2]
    for bulge in bulges:
        # A bulge is a smaller one, spread by the rounding: distances stay exact around its edges.
        side = bulge.outline(p[:, 0], p[:, 1]) + EDGE_ROUNDING_MM
        cap = p[:, 2] - (BULGE_HEIGHT_MM - EDGE_ROUNDING_MM)
        outside = np.hypot(np.maximum(side, 0), np.maximum(cap, 0))
        nearest = np.minimum(
            nearest, np.minimum(np.maximum(side, cap), 0) + outside - EDGE_ROUNDING_MM
        )
    return np.asarray(nearest)


def _top_mm(outline_mm: F64) -> F64:
    side = np.clip(outline_mm + EDGE_ROUNDING_MM, 0, EDGE_ROUNDING_MM)
    top = BULGE_HEIGHT_MM - EDGE_ROUNDING_MM + np.sqrt(EDGE_ROUNDING_MM**2 - side**2)
    return np.where(outline_mm < 0, top, 0.0)


def touchpad() -> Pad:
    """The pad of 90 x 70 mm. Like a real pad's, its edges do not lie on a map's grid."""
    curves = (Arc(14.1, 50.1, 6.0, 3.0, 0.0, 180.0), Arc(26.1, 50.1, 6.0, 3.0, 180.0, 360.0))
    ring = Arc(20.1, 21.1, 11.0, 3.0)
    fences = tuple(
        Bar(x, 12.1, x, 32.1, width)
        # Widths of 2, 3 and 4 mm; gaps of 3, 4, 5 and 6 mm between them.
        for x, width in ((42.1, 2.0), (47.1, 2.0), (53.6, 3.0), (61.6, 3.0), (71.1, 4.0))
    )
    alone = Bar(44.1, 54.1, 78.1, 54.1, 3.0)
    dots = (Dot(80.1, 16.1, 2.0), Dot(80.1, 28.1, 3.5))
    return Pad(90.0, 70.0, (*curves, ring, *fences, alone, *dots))


def raster(pad: Pad, step_mm: float) -> F32:
    """Heights in mm at (j step, i step): float32 (rows, cols)."""
    x = np.arange(round(pad.width_mm / step_mm) + 1) * step_mm
    y = np.arange(round(pad.length_mm / step_mm) + 1) * step_mm
    return pad.height_mm(*np.meshgrid(x, y)).astype(np.float32)


def scan(pad: Pad, step_mm: float, depth_mm: float, apex_mm: float) -> list[Rigid]:
    """``base_T_sensor`` of presses straight down on a grid that reaches every edge of the pad, row
    by row, to and fro, with the undeformed apex `depth_mm` below the highest point.
    """
    # From the highest point, so that every press has a depth; over the plate it is less.
    z = BULGE_HEIGHT_MM - depth_mm + apex_mm
    xs, ys = (
        np.linspace(0, side, math.ceil(side / step_mm) + 1).tolist()
        for side in (pad.width_mm, pad.length_mm)
    )
    return [
        shift(x, y, z) @ _DOWN
        for row, y in enumerate(ys)
        # To and fro: neighbouring presses in time are neighbours in place, as a robot would go.
        for x in (xs if row % 2 == 0 else reversed(xs))
    ]


_DOWN = from_seven((0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0))
"""The sensor looks down: its z is the base's -z, its x the base's x."""


def disturbed(
    poses: Sequence[Rigid], apex_mm: float, sigma_mm: float, sigma_deg: float, seed: int
) -> list[Rigid]:
    """The poses that a robot reports with Gaussian noise along every axis
    and about a random axis through the apex.
    """
    rng = np.random.default_rng((seed, 6))
    out = []
    for pose in poses:
        axis = rng.standard_normal(3)
        rotation = turn(
            axis / np.linalg.norm(axis) * math.radians(sigma_deg) * rng.standard_normal()
        )
        moved = shift(*(sigma_mm * rng.standard_normal(3)).tolist())
        # About the apex: about the origin of the base, a small angle would be a large shift.
        out.append(moved @ about_apex(pose, rotation, apex_mm))
    return out


def about_apex(pose: Rigid, rotation: Rigid, apex_mm: float) -> Rigid:
    """A sensor's pose after a rotation, in the sensor's axes, about its undeformed apex."""
    return pose @ shift(0, 0, apex_mm) @ rotation @ shift(0, 0, -apex_mm)
