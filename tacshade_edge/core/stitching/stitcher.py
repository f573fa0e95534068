"""Fuse the points of many presses into one map in the base frame, by the robot's poses.

Poses are only as good as the robot, as the map itself shows: if the reconstruction's errors explain why presses would
have to move to agree, the poses are taken as exact; otherwise presses move by the robot's part (`refinement`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.stitching.press_points import PressPoints, height_weight
from tacshade_edge.core.stitching.refinement import (
    PoseError,
    correction,
    moved_by_part,
    refine_poses,
    robots_part,
    thin_points,
)
from tacshade_edge.core.stitching.surface_map import MIN_WEIGHT, STEP_MM, Heights, Raster, SurfaceMap
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F32, F64

POINTS_MAX = 4_000_000
"""Limit for all presses together: 16 bytes each, 64 MB."""
# If poses are not exact, some press makes the outline wrong, so a cell needs more weight.
_MIN_WEIGHT_REFINED = 0.15
_CAUCHY_MM = 0.2  # a point at this distance from its cell's mean counts half
# Reject a press that is this far off its neighbours after refinement, or moved by this many standard deviations.
DEVIATION_MAX_MM = 0.6
CORRECTION_MAX_SIGMAS = 5.0


@dataclass(frozen=True, slots=True)
class PlacedPress:
    """One press in a finished map: the pose found, or the reported one if poses are exact; the change from the reported
    one at the apex; why its points are not in the map, if they are not; their number.
    """

    base_T_sensor: Rigid
    correction_mm: float
    correction_deg: float
    rejected: Reason | None
    points: int


@dataclass(frozen=True, slots=True)
class StitchedMap:
    """A finished map: its raster and presses; RMS of the moves in height that would make presses agree (0 if poses were
    given as exact); whether presses were moved because their poses were not taken as exact.
    """

    raster: Raster
    presses: tuple[PlacedPress, ...]
    disagreement_mm: float
    refined: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Press:
    """Points in the sensor frame, their weights in height, the few that refine the pose, and the reported pose."""

    points_mm: F32
    weight: F32
    thinned: F64
    reported: Rigid

    def at(self, base_T_sensor: Rigid) -> F64:
        return base_T_sensor.apply(self.points_mm)


class Stitcher:
    """Collects presses; the map so far is available at any time, the refined one at the end. `apex_mm` is the skin's
    radius.
    """

    def __init__(self, apex_mm: float) -> None:
        self._apex = np.array((0.0, 0.0, apex_mm))
        self._presses: list[_Press] = []
        self._points = 0
        self.map = SurfaceMap(STEP_MM)

    @property
    def presses(self) -> int:
        """Number of presses."""
        return len(self._presses)

    @property
    def points(self) -> int:
        """Number of points of all presses."""
        return self._points

    def add(self, points: PressPoints, base_T_sensor: Rigid) -> None:
        """Add a press at its reported pose; the cost does not grow with the map. Raises ValueError, and adds nothing,
        if the press has no points or the map is full (`POINTS_MAX`, `surface_map.TILES_MAX`).
        """
        count = len(points.points_mm)
        if count == 0:
            raise ValueError("a press without points")
        if self._points + count > POINTS_MAX:
            raise ValueError(f"the map would exceed {POINTS_MAX} points")
        # Refinement turns a pose by a degree or so, which hardly changes the slopes.
        weight = height_weight(points, base_T_sensor)
        press = _Press(points.points_mm, weight.astype(np.float32), thin_points(points), base_T_sensor)
        self.map.add(press.at(base_T_sensor), press.weight)
        self._presses.append(press)
        self._points += count

    def finish(self, error: PoseError | None = PoseError()) -> StitchedMap:  # noqa: B008 (frozen)
        """Find the poses, whose error by the robot is `error` (None: they are exact), leave out presses that do not
        fit, and fuse again without outlying points.
        """
        reported, disagreement_mm = [p.reported for p in self._presses], 0.0
        poses, part = reported, 0.0
        if error is not None and self.presses > 1:
            thinned = [p.thinned for p in self._presses]
            refined = refine_poses(thinned, reported, self._apex, error)
            dz_mm = [(p.apply(self._apex) - r.apply(self._apex))[2] for p, r in zip(refined, reported, strict=True)]
            disagreement_mm = float(np.sqrt(np.mean(np.square(dz_mm))))
            part = robots_part(thinned, reported, refined, self._apex)
        exact = part == 0
        if exact:
            error = None
        else:
            poses = [moved_by_part(r, p, part, self._apex) for r, p in zip(reported, refined, strict=True)]
        heights = self._fused(poses, [None] * len(poses), None).heights()
        placed = [self._placed(press, pose, heights, error) for press, pose in zip(self._presses, poses, strict=True)]
        rejected = [p.rejected for p in placed]
        if any(rejected):
            heights = self._fused(poses, rejected, None).heights()
        fused = self._fused(poses, rejected, heights)
        raster = fused.raster(MIN_WEIGHT if exact else _MIN_WEIGHT_REFINED)
        return StitchedMap(raster, tuple(placed), disagreement_mm, not exact)

    def _placed(self, press: _Press, pose: Rigid, heights: Heights, error: PoseError | None) -> PlacedPress:
        at = pose.apply(press.thinned[:, :3])
        deviation_mm = float(np.median(np.abs(at[:, 2] - heights.z_at(at))))
        correction_mm, correction_deg = correction(press.reported, pose, self._apex)
        rejected = None
        if deviation_mm > DEVIATION_MAX_MM:
            text = f"the press deviates from the other presses by {deviation_mm:.2f} mm"
            rejected = Reason(ReasonCode.PRESS_DEVIATES, text)
        elif error is not None and correction_mm > CORRECTION_MAX_SIGMAS * error.position_mm:
            text = f"refinement would have to move the press by {correction_mm:.2f} mm"
            rejected = Reason(ReasonCode.PRESS_DISPLACED, text)
        elif error is not None and correction_deg > CORRECTION_MAX_SIGMAS * error.rotation_deg:
            text = f"refinement would have to turn the press by {correction_deg:.1f} degrees"
            rejected = Reason(ReasonCode.PRESS_DISPLACED, text)
        return PlacedPress(pose, correction_mm, correction_deg, rejected, len(press.points_mm))

    def _fused(self, poses: Sequence[Rigid], rejected: Sequence[Reason | None], before: Heights | None) -> SurfaceMap:
        """Fuse the presses into a new map, with Cauchy's weight of each point's distance to the map `before`."""
        fused = SurfaceMap(STEP_MM, bounded=False)  # refined presses lie slightly elsewhere
        for press, pose, reason in zip(self._presses, poses, rejected, strict=True):
            if reason is not None:
                continue
            at, weight = press.at(pose), press.weight
            if before is not None:
                weight = np.nan_to_num(weight / (1 + ((at[:, 2] - before.z_at(at)) / _CAUCHY_MM) ** 2))
            fused.add(at, weight)
        return fused
