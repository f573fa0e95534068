"""The plan of docs/how-to/stitching.md for `stitch --find-flange`:
where a robot presses, turns, moves.
"""

from __future__ import annotations

import math

import numpy as np

from support.bumpy_surface import APEX_MM, DOWN, misreported, press_of
from tacshade_edge.lab.simulator.pad import about_apex
from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.stitching.flange import ContactFrame
from tacshade_edge.stitching.refinement import thin_points
from tacshade_edge.types import F64, Pose

SPOTS_MM = tuple((x, y) for y in (-9.0, -3.0, 3.0, 9.0) for x in (-12.0, -6.0, 0.0, 6.0, 12.0))
TURNS_DEG = (
    ((0, 0, 0), (90, 15, 0), (-90, -15, 0), (90, 0, -15), (-90, 0, 15)),
    ((0, 15, 0), (0, -15, 0), (0, 0, 15), (0, 0, -15), (90, 0, 0)),
)
"""Yaw, tilt about the sensor's x and y; the first five at odd spots, the others at even ones."""
SPEED_MM_S, PAUSE_S, LIFT_MM = 10.0, 0.5, 3.0
_TRACK_HZ = 30.0
MIDDLE_NS = 10**12


Turns = tuple[tuple[tuple[int, int, int], ...], ...]


def plan(
    x_mm: float, y_mm: float, skin_radius_mm: float, turns_deg: Turns = TURNS_DEG
) -> list[Rigid]:
    """``base_T_sensor`` of the presses around a place, their undeformed apex at z = 0."""
    poses = []
    for spot, (dx_mm, dy_mm) in enumerate(SPOTS_MM):
        for yaw, tilt_x, tilt_y in turns_deg[spot % len(turns_deg)]:
            straight = (
                shift(x_mm + dx_mm, y_mm + dy_mm, skin_radius_mm)
                @ DOWN
                @ turn((0, 0, math.radians(yaw)))
            )
            tilt = turn((math.radians(tilt_x), math.radians(tilt_y), 0))
            poses.append(about_apex(straight, tilt, skin_radius_mm))
    return poses


def height_mm(t_s: float) -> float:
    """Height in mm of the robot above its press at a time; 0 is the middle of the pause."""
    return min(LIFT_MM, max(0.0, abs(t_s) - PAUSE_S / 2) * SPEED_MM_S)


def time_s(above_mm: float) -> float:
    """Time in s at which it is this far above, going down (negative) or up."""
    return math.copysign(PAUSE_S / 2 + abs(above_mm) / SPEED_MM_S, above_mm) if above_mm else 0.0


def track(base_T_flange: Rigid, phase: float) -> tuple[Pose, ...]:
    """The poses that a robot reports of a press, at `_TRACK_HZ`;
    `phase` 0 to 1 of a period moves their times.
    """
    times_s = (np.arange(-18, 19) + phase) / _TRACK_HZ
    return tuple(
        Pose(MIDDLE_NS + round(t * 1e9), *(shift(0, 0, height_mm(t)) @ base_T_flange).seven())
        for t in times_s.tolist()
    )


def exact_frames(
    flange_T_sensor: Rigid, delay_ms: float, turns_deg: Turns = TURNS_DEG, *, moving: bool = True
) -> list[ContactFrame]:
    """The plan on the bumpy surface: exact points,
    poses that are off by 0.1 mm and 0.1 degrees in every axis.

    If `moving`, every fifth press has a frame on the way down and one on the way up.
    """
    true = plan(15, 15, APEX_MM, turns_deg)
    frames = []
    for k, (pose, reported) in enumerate(zip(true, misreported(true, 1, 0.1, 0.1), strict=True)):
        base_T_flange = reported @ flange_T_sensor.inverse()
        frames.append(ContactFrame(_points(pose, k), k, 0, (Pose(0, *base_T_flange.seven()),)))
        for above_mm in (-1.0, 1.0) if moving and k % 5 == 0 else ():
            t_ns = MIDDLE_NS + round(time_s(above_mm) * 1e9 + delay_ms * 1e6)
            lifted = shift(0, 0, abs(above_mm)) @ pose
            frames.append(
                ContactFrame(_points(lifted, k), k, t_ns, track(base_T_flange, k % 7 / 7))
            )
    return frames


def _points(base_T_sensor: Rigid, seed: int) -> F64:
    return thin_points(press_of(base_T_sensor, seed))
