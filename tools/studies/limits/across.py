"""True and found heights along a line across a press."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.render import project
from tacshade_edge.simulator.scene import SimulatedFrame
from tacshade_edge.simulator.truth import skin_points
from tacshade_edge.types import F64, HeightMap

REACH_MM = 12.0


@dataclass(frozen=True, slots=True, eq=False)
class Across:
    """A line in the image through a press's middle, along the press's own x axis.

    Attributes
    ----------
    x_mm : float (N,)
        Coordinate along this axis of the skin point that each pixel of the line shows.
    true_mm : float (N,)
        True h of this skin point.
    row, col : float (N,)
        Coordinates of the pixels.
    """

    x_mm: F64
    true_mm: F64
    row: F64
    col: F64


def across(frame: SimulatedFrame, press: Press) -> Across:
    """Place the line, with points one pixel apart, and compute the true skin along it."""
    geometry, r = frame.model.geometry, frame.model.skin_radius_mm
    turn = math.radians(press.rotation_deg)
    along = np.array((math.cos(turn), math.sin(turn)))
    middle = np.array((press.x_mm, press.y_mm, press.lowest_z_mm(r)))
    col, row = project(geometry, middle[None])[0]
    reach = int(REACH_MM / geometry.mm_per_px)
    t = np.arange(-reach, reach + 1)
    col, row = col + t * along[0], row + t * along[1]
    inside = np.hypot(row - geometry.disc.row_c, col - geometry.disc.col_c) < geometry.disc.radius_px - 1
    row, col = row[inside], col[inside]
    points = skin_points(frame.skin, geometry, row, col)
    x = (points[:, :2] - middle[:2]) @ along
    return Across(x, r - np.linalg.norm(points, axis=1), row, col)


def found_heights(line: Across, height: HeightMap) -> F64:
    """Sample a height map at the line's pixels; NaN where the map has no height."""
    j, i = (line.col - height.col0) / height.step_px, (line.row - height.row0) / height.step_px
    map_mm = np.ascontiguousarray(height.height_mm)
    sampled = cv2.remap(map_mm, j.astype(np.float32)[:, None], i.astype(np.float32)[:, None], cv2.INTER_LINEAR)
    return np.asarray(sampled[:, 0], np.float64)


def dip_mm(x_mm: F64, h_mm: F64, width_mm: float, gap_mm: float) -> float:
    """Compute how far in mm the gap's lowest point lies below the lower of the two bars' maxima."""
    side = np.abs(x_mm) - gap_mm / 2
    bar = (side >= 0) & (side <= width_mm)
    left, right, middle = h_mm[bar & (x_mm < 0)], h_mm[bar & (x_mm > 0)], h_mm[side < 0]
    return float(min(np.nanmax(left), np.nanmax(right)) - np.nanmin(middle))


def top_mm(x_mm: F64, h_mm: F64, width_mm: float) -> float:
    """Find the greatest h in mm over a ridge and half a millimetre on either side."""
    return float(np.nanmax(h_mm[np.abs(x_mm) <= width_mm / 2 + 0.5]))
