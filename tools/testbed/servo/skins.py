"""The simulated sensor's skin under a plane or under a plate's edge, interpolated:
a frame takes 7 ms instead of 30.

The skin under a plane is symmetric about the plane's normal, so one press per depth serves every
tilt. The skin under an edge is turned about the sensor's axis. Plane and edge slide on the skin
without drag.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from tacshade_edge.lab.simulator.press import OBJECTS, Press, Shape
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.skin import Skin, node_directions, press_skin, undeformed
from tacshade_edge.types import F32, F64

MODEL: Final = replace(
    SensorModel(),
    image_height_px=240,
    image_width_px=320,
    row_c=118.2,
    col_c=163.8,
    disc_radius_px=102.5,
)
"""The sensor, whose image has a width that ``rpicam-vid`` can write."""
DEEPEST_MM: Final = 4.0
PLANE_DEPTHS_MM: Final = np.arange(0, DEEPEST_MM + 0.01, 0.1)
EDGE_DEPTHS_MM: Final = np.arange(0, 3.51, 0.25)
OFFSETS_MM: Final = np.arange(-8, 8.01, 0.5)
_ROUNDING_MM = 0.2
_FREE = undeformed(MODEL.skin_radius_mm)


class PlaneSkins:
    """Skins under a plane at any depth and with any normal."""

    def __init__(self) -> None:
        directions = node_directions(MODEL.skin_radius_mm).astype(np.float32)
        middle = len(directions) // 2
        self._directions = directions
        self._cosines = directions[middle, middle:, 2][::-1].astype(
            np.float64
        )  # ascending, for np.interp
        self._profiles = np.stack(
            [
                _pressed(Press(OBJECTS["plate"](), depth_mm=float(depth)))[middle, middle:][::-1]
                for depth in PLANE_DEPTHS_MM
            ]
        )

    def skin(self, depth_mm: float, normal: F64) -> Skin:
        """Make the skin that a plane, whose unit normal (3,) points away from O,
        presses by `depth_mm`.
        """
        step = float(PLANE_DEPTHS_MM[1])
        at = min(max(depth_mm, 0.0), DEEPEST_MM) / step
        low = min(int(at), len(PLANE_DEPTHS_MM) - 2)
        profile = (1 - (at - low)) * self._profiles[low] + (at - low) * self._profiles[low + 1]
        height = np.interp(self._directions @ normal.astype(np.float32), self._cosines, profile)
        return replace(_FREE, height_mm=height.astype(np.float32))


class EdgeSkins:
    """Skins under a plate's straight edge at right angles to the sensor's axis;
    a file keeps their table (10 s).
    """

    def __init__(self, kept: Path) -> None:
        if not kept.exists():
            pairs = [(depth, offset) for depth in EDGE_DEPTHS_MM for offset in OFFSETS_MM]
            np.save(
                kept, np.stack([_pressed(edge_press(float(d), float(o), 0.0)) for d, o in pairs])
            )
        shape = (len(EDGE_DEPTHS_MM), len(OFFSETS_MM), *_FREE.height_mm.shape)
        self._table: F32 = np.load(kept).reshape(shape)

    def skin(self, depth_mm: float, offset_mm: float, edge_deg: float) -> Skin:
        """Make the skin under a press as placed by `edge_press`."""
        i, a = _between(depth_mm, EDGE_DEPTHS_MM)
        j, b = _between(offset_mm, OFFSETS_MM)
        t = self._table
        height = (1 - a) * ((1 - b) * t[i, j] + b * t[i, j + 1]) + a * (
            (1 - b) * t[i + 1, j] + b * t[i + 1, j + 1]
        )
        middle = len(height) // 2
        turn = cv2.getRotationMatrix2D(
            (middle, middle), -edge_deg, 1.0
        )  # OpenCV's angles go from y towards x
        return replace(
            _FREE, height_mm=cv2.warpAffine(height.astype(np.float32), turn, height.shape)
        )


def edge_press(depth_mm: float, offset_mm: float, edge_deg: float) -> Press:
    """Press a half plate at z = r - `depth_mm`, which lies in the direction `edge_deg` + 90°
    from its edge.

    The edge runs in the direction `edge_deg`, from x towards y,
    at `offset_mm` from the axis towards the plate.
    """
    angle, r = math.radians(edge_deg), MODEL.skin_radius_mm
    x_mm, y_mm = -offset_mm * math.sin(angle), offset_mm * math.cos(angle)
    depth_there = math.sqrt(r * r - offset_mm**2) - (r - depth_mm)
    return Press(HALF_PLATE, x_mm, y_mm, depth_there, edge_deg)


def _half_plate(p: F64) -> F64:
    side, cap = _ROUNDING_MM - p[:, 1], _ROUNDING_MM - p[:, 2]
    outside = np.hypot(np.maximum(side, 0), np.maximum(cap, 0))
    return np.asarray(np.minimum(np.maximum(side, cap), 0) + outside - _ROUNDING_MM)


HALF_PLATE: Final = Shape("half plate", _half_plate)
"""The half plate with y > 0 and z > 0, whose edge is rounded by 0.2 mm."""


def _pressed(press: Press) -> F32:
    return press_skin(MODEL.skin_radius_mm, MODEL.skin_decay_mm, (press,)).height_mm


def _between(value: float, nodes: F64) -> tuple[int, float]:
    """Find the node at or below a value (clipped to the nodes),
    and the value's part of the way to the next, 0 to 1.
    """
    at = (min(max(value, float(nodes[0])), float(nodes[-1])) - float(nodes[0])) / float(
        nodes[1] - nodes[0]
    )
    low = min(int(at), len(nodes) - 2)
    return low, at - low
